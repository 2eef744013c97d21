"""``taxinet bag golden``: runs the golden bags' scenes again, and records them anew if asked."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from taxinet_ros.bag.golden import (
    GoldenResult,
    compare_golden,
    golden_bags,
    same_stack,
    stack_differences,
    write_stack,
)
from taxinet_ros.bag.layout import METADATA_FILE, mcap_path
from taxinet_ros.bag.recorded_run import RecordedRun, read_run
from taxinet_ros.cli.bag_compare import DIFFERENT, EQUAL, print_comparison
from taxinet_ros.cli.bag_input import controller_of, perception_of, perception_words, readable_bags
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.core.outcome import Outcome, RunResult
from taxinet_ros.nodes.rerun import rerun


def run_golden(folder: Path, *, update: bool) -> int:
    """Run every golden scene again, print how each compares, and replace what differs if asked.

    Returns:
        Exit code: 0 the same, or replaced; 1 different.

    Raises:
        UsageError: there are no golden bags, or one cannot be read.
        InfraError: the bench broke; nothing is replaced then.
    """
    console = Console(highlight=False)
    bags = golden_bags(folder)
    with readable_bags():
        runs = {bag: read_run(bag) for bag in bags}
    for bag, run in runs.items():
        if run.request.run_id != bag.name:
            raise UsageError(f'{bag}: holds run {run.request.run_id}; name the folder so')
    if other := stack_differences(folder):
        console.print(f'another stack than theirs: {other}', soft_wrap=True, markup=False)
    with tempfile.TemporaryDirectory(prefix='taxinet-golden-') as scratch:
        words = [
            (run, perception_of(run, None)[0], controller_of(run, None)) for run in runs.values()
        ]
        _check(rerun(words, Path(scratch), images='none'), runs)
        results = [
            compare_golden(
                bag, Path(scratch) / bag.name, perception=run.perception,
                to_the_bit=update or same_stack(folder),
            )
            for bag, run in runs.items()
        ]
        for result in results:
            run = runs[result.bag]
            words_ = perception_words(run.perception, run.fingerprint)
            console.print(f'{result.bag.name}, perception {words_}:', soft_wrap=True)
            print_comparison(console, result.topics, result.tolerance)
        changed = [result for result in results if not result.equal]
        if update:
            for result in changed:
                _replace(result)
            write_stack(folder)
            console.print(f'{len(changed)} of {len(results)} golden bags recorded anew')
            return EQUAL
    return DIFFERENT if changed else EQUAL


def _check(results: Mapping[str, RunResult], runs: Mapping[Path, RecordedRun]) -> None:
    for run in runs.values():
        name = run.request.run_id
        result = results.get(name, RunResult(outcome=Outcome.INTERRUPTED))
        if result.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not result.outcome.judged:
            detail = f'{name}: {result.detail}'
            raise InfraError(result.kind, result.who, result.last_seq, detail)


def _replace(result: GoldenResult) -> None:
    for name in (mcap_path(result.bag).name, METADATA_FILE):
        (result.bag / name).write_bytes((result.again / name).read_bytes())
