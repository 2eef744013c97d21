"""``taxinet bag golden``: run the scenes of the golden bags again and compare."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import InfraError, UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.check.compare import GoldenResult
    from taxinet_ros.bag.run.facts import RecordedRun
    from taxinet_ros.core.verdict.outcome import RunResult


def golden(
    folder: Annotated[
        Path, typer.Argument(metavar='[DIR]', help='folder of bags', show_default=True)
    ] = Path('bags/golden'),
    update: Annotated[
        bool, typer.Option('--update', help='show the differences, then re-record the bags that '
        'differ')
    ] = False,
) -> int:
    """Rerun the scenes of the golden bags and compare, to see the effect of a change.

    On another processor or library version, values may differ slightly. Exit code: 0 identical, or
    updated with --update; 1 different.
    """
    from taxinet_ros.bag.check.compare import (
        compare_golden,
        golden_bags,
        same_stack,
        stack_differences,
        write_stack,
    )
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL, print_comparison
    from taxinet_ros.nodes.graph.replay import rerun
    from taxinet_ros.trials.past_runs.repeated_run import (
        controller_of,
        perception_of,
        perception_words,
        readable_bags,
    )

    console = line_console()
    bags = golden_bags(folder)
    with readable_bags():
        runs = {bag: open_recording(bag).run for bag in bags}
    for bag, run in runs.items():
        if run.request.run_id != bag.name:
            raise UsageError(f'{bag}: holds run {run.request.run_id}; rename the folder to match')
    if other := stack_differences(folder):
        console.print(f'other software stack than the golden bags: {other}')
    with tempfile.TemporaryDirectory(prefix='taxinet-golden-') as scratch:
        words = [
            (run, perception_of(run, None)[0], controller_of(run, None)) for run in runs.values()
        ]
        _check_golden(rerun(words, Path(scratch), images='none'), runs)
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
            console.print(f'{result.bag.name}, perception {words_}:')
            print_comparison(console, result.topics, result.tolerance)
        changed = [result for result in results if not result.equal]
        if update:
            for result in changed:
                _replace_golden(result)
            write_stack(folder)
            console.print(f'{len(changed)} of {len(results)} golden bags re-recorded')
            return EQUAL
    return DIFFERENT if changed else EQUAL


def _check_golden(results: Mapping[str, RunResult], runs: Mapping[Path, RecordedRun]) -> None:
    from taxinet_ros.core.verdict.outcome import Outcome, RunResult

    for run in runs.values():
        name = run.request.run_id
        result = results.get(name, RunResult(outcome=Outcome.INTERRUPTED))
        if result.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not result.outcome.judged:
            detail = f'{name}: {result.detail}'
            raise InfraError(result.kind, result.who, result.last_seq, detail)


def _replace_golden(result: GoldenResult) -> None:
    from taxinet_ros.bag.layout import METADATA_FILE, mcap_path

    for name in (mcap_path(result.bag).name, METADATA_FILE):
        (result.bag / name).write_bytes((result.again / name).read_bytes())
