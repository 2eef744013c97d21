"""What another stack would change of a run, as far as one machine can tell.

``python benchmarks/other_stacks.py --scenes 6 --duration 30`` runs the same scenes, in one process
without ROS, with the shipped network in the hands of torch in place of onnxruntime, and with numpy,
OpenCV and the C library kept from using this processor's newer instructions, as they would be on an
older one. It prints by how much the runs differ from those of a second process like the first.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.network import ARCHITECTURES, normalise, shrink, unscaled
from taxinet_ros.core.perception.perception import Perception, make_perception
from taxinet_ros.core.perception.weights import SHIPPED, load_model
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import TrackingError

SCENES = [
    {'cross_track': 6.0, 'heading': -12, 'distance': 700, 'time_of_day': 9.5},
    {'cross_track': -6.5, 'heading': 20, 'distance': 1000, 'time_of_day': 15.2,
     'clouds': 'overcast', 'rain': 60},
    {'cross_track': 2.0, 'heading': 5, 'distance': 200, 'time_of_day': 12.0, 'clouds': 'broken'},
    {'cross_track': -3.0, 'heading': -25, 'distance': 1500, 'time_of_day': 7.0},
    {'cross_track': 7.5, 'heading': 28, 'distance': 1900, 'time_of_day': 17.3,
     'clouds': 'scattered'},
    {'cross_track': 0.0, 'heading': 0, 'distance': 1300, 'time_of_day': 10.4, 'clouds': 'cirrus'},
]
_OLD_NUMPY = {'NPY_DISABLE_CPU_FEATURES': 'X86_V3', 'OPENBLAS_CORETYPE': 'Nehalem'}
_OLD_OPENCV = {'OPENCV_CPU_DISABLE': 'AVX2,FP16,AVX'}
_OLD_LIBC = {'GLIBC_TUNABLES': 'glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F'}
STACKS: dict[str, dict[str, str]] = {
    'another process': {},
    'torch': {},
    'numpy without AVX2': _OLD_NUMPY,
    'OpenCV without AVX': _OLD_OPENCV,
    'C library without FMA': _OLD_LIBC,
    'all three': {**_OLD_NUMPY, **_OLD_OPENCV, **_OLD_LIBC},
}
"""What is changed, by the environment that changes it."""

SIGNALS = ('x_m', 'cte_m', 'he_rad', 'est_cte_m', 'est_he_rad')


class InTorch(Perception):
    """The shipped network, run by torch; counts how far onnxruntime's answers are from its own."""

    word, fingerprint, needs_image = 'taxinet', '', True

    def __init__(self) -> None:
        import torch

        from taxinet_ros.training.torch_network import torch_network

        torch.set_num_threads(1)
        model = load_model(SHIPPED['taxinet'])
        self._torch = torch
        self._network = torch_network(ARCHITECTURES[model.card.architecture])
        weights = {name: torch.from_numpy(w.copy()) for name, w in model.weights.items()}
        self._network.load_state_dict(weights)
        self._other = make_perception('taxinet')
        self.apart: list[tuple[float, float]] = []

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """The answer of torch."""
        assert image is not None
        with self._torch.inference_mode():
            pictures = self._torch.from_numpy(normalise(shrink(image)[np.newaxis]))
            cte_m, he_rad = unscaled(self._network(pictures).numpy())[0]
        other = self._other.estimate(image, None)
        self.apart.append((abs(cte_m - other.cte_m), abs(he_rad - other.he_rad)))
        return TrackingError(cte_m=float(cte_m), he_rad=float(he_rad))


def traces(stack: str, scenes: int, duration_s: float) -> dict[str, np.ndarray]:
    """Every signal of every scene (scenes, steps), and what else there is to compare."""
    perception = InTorch() if stack == 'torch' else make_perception('taxinet')
    found: dict[str, list] = {name: [] for name in (*SIGNALS, 'picture', 'rho')}
    for values in SCENES[:scenes]:
        scene: Scenario = scenario_from_human({**values, 'duration': duration_s})
        steps: list[Step] = []
        spec = parse_spec('phi_always')
        judgement = run_closed_loop(scene, perception, specs=[spec], on_step=steps.append)
        rows = [
            (s.observation.state.x_m, s.observation.state.tracking_error.cte_m,
             s.observation.state.tracking_error.he_rad, s.estimate.cte_m, s.estimate.he_rad)
            for s in steps
        ]
        for name, column in zip(SIGNALS, np.array(rows).T, strict=True):
            found[name].append(column)
        found['picture'].append([zlib.crc32(s.observation.image.tobytes()) for s in steps])
        found['rho'].append(judgement.readings[0].lower)
    found['apart'] = perception.apart if isinstance(perception, InTorch) else [(0.0, 0.0)]
    return {name: np.array(values) for name, values in found.items()}


def measure(stack: str, scenes: int, duration_s: float) -> dict[str, np.ndarray]:
    """:func:`traces` in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, 'traces.npz')
        subprocess.run(
            [sys.executable, __file__, '--child', stack, '--into', str(file),
             '--scenes', str(scenes), '--duration', str(duration_s)],
            env={**os.environ, **STACKS[stack]}, check=True,
        )
        with np.load(file) as loaded:
            return dict(loaded)


def compared(expected: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> dict[str, float]:
    """The largest differences between two sets of runs, over all scenes and steps."""
    far = {name: float(np.abs(expected[name] - other[name]).max()) for name in (*SIGNALS, 'rho')}
    return {
        **far,
        'pictures': int((expected['picture'] != other['picture']).sum()),
        'first pictures': int((expected['picture'][:, 0] != other['picture'][:, 0]).sum()),
        'frames': expected['picture'].size,
        'verdicts': int(((expected['rho'] < 0) != (other['rho'] < 0)).sum()),
        'apart_cte_m': float(other['apart'][:, 0].max()),
        'apart_he_rad': float(other['apart'][:, 1].max()),
    }


def main() -> None:
    """Compare the stacks, or with ``--child`` run the scenes in one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--scenes', type=int, default=len(SCENES))
    parser.add_argument('--duration', type=float, default=30.0)
    parser.add_argument('--child', choices=list(STACKS), help=argparse.SUPPRESS)
    parser.add_argument('--into', type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.child:
        np.savez(asked.into, **traces(asked.child, asked.scenes, asked.duration))
        return
    expected = traces('another process', asked.scenes, asked.duration)
    print(f'{asked.scenes} scenes of {asked.duration:g} s; rho of phi_always', expected['rho'])
    for stack in STACKS:
        other = measure(stack, asked.scenes, asked.duration)
        found = compared(expected, other)
        print(f'{stack}:', ', '.join(f'{name} {value:.3g}' for name, value in found.items()))
        by_scene = np.abs(expected['cte_m'] - other['cte_m']).max(axis=1)
        print('  cte_m by scene:', *(f'{far:.2g}' for far in by_scene), flush=True)


if __name__ == '__main__':
    main()
