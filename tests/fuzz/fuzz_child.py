"""Feeds mutants to what may take a whole process down: native libraries behind our readers.

``python fuzz_child.py TARGET FOLDER COUNT SEED`` prints one line for each mutant before it is read,
and one on how it ended; the test reads them, and knows which one a crash belongs to.
"""

from __future__ import annotations

import os
import resource
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import conftest  # noqa: F401  (finds the modules that follow)
import fuzz_watch
import numpy as np
import onnx_samples
import planted_runs
from fuzz_mutations import mutants

from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.core.perception.onnx.network import NetworkFiles, OnnxNetwork
from taxinet_ros.core.perception.onnx.trial import inspect

MEMORY_BYTES = 4 << 30
"""Address space of a child: pyarrow reserves a gigabyte that it never touches."""


def onnx(folder: Path) -> tuple[list[bytes], Callable[[bytes], object]]:
    """Models beside a sound description; those that load look at a frame."""
    corpus = [onnx_samples.linear().SerializeToString()]
    path = onnx_samples.save(folder)
    frame = np.full((200, 360, 3), 90, np.uint8)

    def use(data: bytes) -> object:
        path.write_bytes(data)
        files = NetworkFiles.read(path)
        inspect(files)
        return OnnxNetwork(files).look(frame)
    return corpus, use


def table(folder: Path) -> tuple[list[bytes], Callable[[bytes], object]]:
    """Tables of campaigns, as an analysis reads them."""
    planted_runs.planted_table(20, 1, lambda runs: 0.5).to_parquet(folder / 'sound.parquet')
    path = folder / 'runs.parquet'

    def use(data: bytes) -> object:
        path.write_bytes(data)
        return read_runs(folder)
    return [(folder / 'sound.parquet').read_bytes()], use


PARAMETERS = b"""/**:
  ros__parameters:
    use_sim_time: false
/simulator:
  ros__parameters:
    use_sim_time: false
    answer_timeout: 5.0
    ready_timeout: 30.0
steering_controller:
  ros__parameters: {heading_gain: 1.0}
"""


def parameters(folder: Path) -> tuple[list[bytes], Callable[[bytes], object]]:
    """Parameter files, as each executable reads them: from its command line to its node."""
    from taxinet_ros.errors import UsageError
    from taxinet_ros.nodes.running.node_main import run_node
    from taxinet_ros.nodes.running.parameters import Usage
    from taxinet_ros.nodes.simulator import Simulator
    from taxinet_ros.nodes.steering_controller import SteeringController

    path = folder / 'parameters.yaml'
    usage = Usage(executable='fuzzed', does='')
    said = os.memfd_create('said')

    def use(data: bytes) -> object:
        path.write_bytes(data)
        sys.argv = ['node', '--ros-args', '--params-file', str(path)]
        node = Simulator if sum(data) % 2 else SteeringController
        os.ftruncate(said, 0)
        os.lseek(said, 0, os.SEEK_SET)
        sys.stderr.flush()
        before = os.dup(2)
        os.dup2(said, 2)
        try:
            run_node(node, lambda node, executor: 0, usage=usage)
        except SystemExit as end:
            sys.stderr.flush()
            lines = os.pread(said, 1 << 20, 0).decode(errors='replace').splitlines(keepends=True)
            words = ''.join(line for line in lines if not line.startswith('[INFO]'))
            if end.code == 2:
                raise UsageError(words.removeprefix('error: ').rstrip('\n')) from None
            if end.code != 0 or words:
                raise AssertionError(f'exit code {end.code}: {words[:1000]}') from None
        finally:
            os.dup2(before, 2)
            os.close(before)
    return [PARAMETERS], use


TARGETS = {'onnx': (onnx, False), 'table': (table, False), 'parameters': (parameters, True)}


def main(name: str, folder: Path, count: int, seed: int) -> None:
    """Read mutant after mutant; errors that are not ours end it."""
    warnings.simplefilter('ignore')
    make, text = TARGETS[name]
    corpus, use = make(folder)
    for data in corpus:
        print('sound', fuzz_watch.end_of(lambda data=data: use(data)), flush=True)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    for data in mutants(corpus, count, seed, text=text):
        (folder / 'last').write_bytes(data)
        print('mutant', fuzz_watch.end_of(lambda data=data: use(data)), flush=True)
    print('whole', 'end')


if __name__ == '__main__':
    main(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
