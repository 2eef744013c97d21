"""How well looks foretell runs, and what they cost, on scenes whose results are recorded.

``python tests/campaign/looks_and_runs.py bags/s_falsif_iterative-learned_400.parquet
iterative-learned``; about two minutes on an idle core. The table's scenes are looked at with a
picture every so many control steps, and every tenth of them is run again to compare the time.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import taxinet_ros  # noqa: F401 (before numpy, which it restricts)

# isort: split
import cv2
import numpy as np
from sklearn.metrics import roc_auc_score
from threadpoolctl import threadpool_limits

from taxinet_ros.campaign.loop_run import Loop, LoopOptions
from taxinet_ros.campaign.record.table import read_any_table
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.pacing.timing import AT_ONCE
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import HUMAN_KEYS
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest

EVERY = (5, 10, 20, 50)
_SPEC = SHIPPED['phi_eventually']
_RESAMPLES = 2000


def made(loop: Loop, scenario: Scenario) -> tuple[float, float]:
    """Robustness of a run or a look, and its processor time [s]."""
    begun_s = time.process_time()
    result = loop.run(RunRequest(
        run_id='look', index=0, program='', seed=0, scenario=scenario, participants=(),
        judging=Judging(specs=(f'{_SPEC.name}={_SPEC.text}',)),
    ))
    return result.robustness[_SPEC.name].lower, time.process_time() - begun_s


def interval(failed: np.ndarray, looks: np.ndarray) -> tuple[float, float]:
    """95 % interval of the area under the curve, by bootstrap within failures and passes."""
    chance = np.random.default_rng(0)
    groups = np.flatnonzero(failed), np.flatnonzero(~failed)
    found = []
    for _ in range(_RESAMPLES):
        some = np.concatenate([chance.choice(each, len(each)) for each in groups])
        found.append(roc_auc_score(failed[some], -looks[some]))
    low, high = np.quantile(found, (0.025, 0.975))
    return float(low), float(high)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument('table', type=Path)
    parser.add_argument('perception')
    parser.add_argument('--scenes', type=int, default=10**9)
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    rows = read_any_table(asked.table).head(asked.scenes)
    scenes = [
        scenario_from_human({key: row[key] for key in HUMAN_KEYS if row.get(key) == row.get(key)
                             and row.get(key) is not None})
        for row in rows.to_dict('records')
    ]
    failed = rows['rho'].to_numpy() <= 0
    with threadpool_limits(limits=1):
        loops = {every: Loop(LoopOptions(
            perception=asked.perception, controller='steering', controller_sha256='', gains={},
            timing=AT_ONCE, world='kmwh', world_sha256='', out=None, images='none', every=every,
        )) for every in (1, *EVERY)}
        full_s = statistics.median(made(loops[1], scene)[1] for scene in scenes[::10])
        print(f'{len(scenes)} scenes, {failed.sum()} failures; a run: {1e3 * full_s:.0f} ms')
        for every in EVERY:
            looks, times = np.array([made(loops[every], scene) for scene in scenes]).T
            low, high = interval(failed, looks)
            hit, false = (looks[failed] <= 0).sum(), (looks[~failed] <= 0).sum()
            print(
                f'every {every}: {1e3 * np.median(times):.0f} ms, '
                f'{np.median(times) / full_s:.2f} runs; area {roc_auc_score(failed, -looks):.3f} '
                f'({low:.3f}-{high:.3f}); at or below 0: {hit} of {failed.sum()} failures, '
                f'{false} of {(~failed).sum()} passes'
            )


if __name__ == '__main__':
    main()
