"""Records of campaigns: time and memory to record runs, and to open, tabulate and resume them.

The runs are made up, and recorded as a command records them. Each reading is in a process of its
own. Times are of the processor, without those of imports.
"""

from __future__ import annotations

import multiprocessing
import random
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from common import Progress, count, leave, make_table, options, run_study

from rich.console import Console

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.core.verdict.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.book import CampaignBook, finished_row
from taxinet_ros.trials.record.content import StoredRows, read_campaign
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.resumption import check_same_campaign, unfinished_search
from taxinet_ros.trials.record.table import campaign_table
from taxinet_ros.trials.summary import Summary, campaign_summary

SIZES = (1_000, 10_000)


def _options(folder: Path, runs: int) -> CampaignOptions:
    return CampaignOptions(
        program='nominal', runs=runs, seed=0, perception='taxinet', out=folder, images='none',
        bags=False,
    )


def _facts(asked: CampaignOptions) -> dict[str, Any]:
    return facts_of_runs(asked, {'program': 'nominal', 'first_runs': asked.runs})


def _errors(draw: random.Random) -> ErrorStatistics:
    return ErrorStatistics(mean=draw.random(), mean_abs=draw.random(), max_abs=draw.random())


def record(folder: Path, runs: int) -> None:
    """Record made-up runs; about every tenth fails."""
    asked, draw = _options(folder, runs), random.Random(0)
    headline = asked.judging.headline
    scenes = [
        Scenario(
            cross_track_m=draw.uniform(-2, 2), distance_m=draw.uniform(500, 2000),
            heading_rad=draw.uniform(-0.1, 0.1),
        )
        for _ in range(100)
    ]
    rows, summary = StoredRows(folder / RECORD_NAME, (), {}), Summary()
    with CampaignBook(asked, ('perception',)) as book:
        book.begin(_facts(asked))
        for index in range(runs):
            request = book.begin_run(index, scenes[index % len(scenes)])
            rho = draw.uniform(-0.1, 0.9)
            row = finished_row(asked, request, RunResult(
                outcome=Outcome.PASS if rho > 0 else Outcome.FAIL,
                robustness={headline: RobustnessInterval.exactly(rho)},
                last_seq=300, wall_s=draw.uniform(0.3, 0.5), statistics=RunStatistics(
                    max_cross_track_m=draw.random(), settle_time_s=draw.random(),
                    cte_error=_errors(draw), he_error=_errors(draw),
                    unusable_estimates=0,
                ),
            ))
            rows.append(row)
            summary.take(row)
            book.keep(row)
        book.complete = True
    assert campaign_summary(summary, asked)


def read(folder: Path, runs: int) -> None:
    """Open a campaign."""
    assert len(read_campaign(folder).rows) == runs


def tabulate(folder: Path, runs: int) -> None:
    """Open a campaign and make its table, as ``analyze`` does."""
    assert len(campaign_table(read_campaign(folder))) == runs


def resume(folder: Path, runs: int) -> None:
    """Open a campaign and see what is done, as ``falsify --resume`` does."""
    asked = _options(folder, runs)
    with CampaignBook(asked, ('perception',), resume=True) as book:
        check_same_campaign(folder, book.earlier, _facts(asked))
        assert not unfinished_search(book.earlier, LAG)[1]
        assert len(book.earlier.by_index) == runs


STEPS: dict[str, Callable[[Path, int], None]] = {
    'record': record, 'open': read, 'table': tabulate, 'resume': resume,
}


def measure(name: str, folder: Path, runs: int) -> dict[str, float]:
    """Processor time [s] of a step, and memory [MB] at its peak beyond that before it."""
    import pandas  # noqa: F401 - not measured
    import pyarrow.compute
    import pyarrow.json  # noqa: F401 - not measured

    before, begun = _peak_mb(), time.process_time()
    STEPS[name](folder, runs)
    return {'cpu_s': time.process_time() - begun, 'memory_mb': _peak_mb() - before}


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000


def measure_records(sizes: Sequence[int], progress: Progress) -> dict[str, Any]:
    """Figures of each step by number of runs."""
    figures: dict[str, Any] = {}
    steps = [(runs, name) for runs in sizes for name in STEPS]
    with tempfile.TemporaryDirectory(prefix='taxinet-records-') as root:
        for done, (runs, name) in enumerate(steps, 1):
            # A process of its own, whose peak memory is that of this step.
            with multiprocessing.get_context('spawn').Pool(1) as process:
                found = process.apply(measure, (name, Path(root, str(runs)), runs))
            figures.setdefault(str(runs), {})[name] = found
            progress(done, len(steps))
    return figures


def show(figures: dict[str, Any], console: Console) -> None:
    """Print the figures."""
    table = make_table(['runs', 'step'], ['processor', 'a run', 'memory'])
    for runs, found in figures.items():
        for name, one in found.items():
            table.add_row(
                f'{int(runs):,}', name, f'{one["cpu_s"]:.2f} s',
                f'{one["cpu_s"] / int(runs) * 1e3:.3f} ms', f'{one["memory_mb"]:.0f} MB',
            )
    console.print(table)


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = options(__doc__)
    parser.add_argument('sizes', nargs='*', type=count, metavar='RUNS',
                        help='numbers of runs (default 1000 and 10000)')
    given = parser.parse_args(words)
    measure_sizes = partial(measure_records, given.sizes or SIZES)
    return run_study(measure_sizes, show, as_json=given.json)


if __name__ == '__main__':
    leave(main)
