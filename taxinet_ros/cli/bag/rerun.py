"""``taxinet run --from`` and ``taxinet bag golden``: run a recorded scenario again and compare."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from rich.console import Console

from taxinet_ros.bag.check.compare import (
    GoldenResult,
    compare_bags,
    compare_golden,
    golden_bags,
    same_stack,
    stack_differences,
    write_stack,
)
from taxinet_ros.bag.layout import METADATA_FILE, mcap_path
from taxinet_ros.bag.rewrite.frames import IMAGE
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import recorded_world
from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL, print_comparison
from taxinet_ros.cli.bag.input import (
    controller_of,
    perception_of,
    perception_words,
    readable_bags,
    warn_of_stacks,
)
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes.graph.replay import rerun
from taxinet_ros.processes.interrupts import ToldInterrupt
from taxinet_ros.trials.options import DEFAULT_ROOT, IMAGES, check_new, new_folder
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import row_line

_TAKEN_BESIDE_FROM = frozenset({
    'bag', 'run_id', 'perception', 'perception_cmd', 'controller', 'controller_cmd', 'out',
    'images', 'processes',
})
"""Options of ``taxinet run`` allowed with ``--from``."""


def check_options(given: Iterable[str]) -> None:
    """Refuse given parameters of ``taxinet run`` that contradict the recorded run."""
    names = {'settings': '--set', 'scenario': 'SCENARIO', 'free': 'whether --free'}
    for name in given:
        if name in ('engine', 'audit'):
            raise UsageError(f'--from: --{name}: a rerun is always made on the graph')
        if name == 'workers':
            raise UsageError('--from: --workers: no effect on the single run of a bag')
        if name not in _TAKEN_BESIDE_FROM:
            option = names.get(name, '--' + name.replace('_', '-'))
            raise UsageError(f'--from: {option} is taken from the bag')


def run_again(
    recording: Recording, *, perception: str | None, controller: str | None, out: Path | None,
    images: str | None, processes: bool,
) -> int:
    """Rerun a bag's scenario in the graph and print the comparison of both runs.

    Args:
        recording: recording of the run.
        perception: word or file; None: the run's own.
        controller: word; None: the run's own.
        out: new folder for the new bag; None: one below ``bags/``.
        images: as for ``taxinet run``; None: as in the bag.
        processes: run every node in its own process.

    Returns:
        Exit code: 0 bit-identical, 1 different.
    """
    with readable_bags():
        run, info = recording.run, recording.info
        if run.fork:
            raise UsageError(
                f'{recording.path}: is a fork, which the graph cannot repeat; fork its run again: '
                'taxinet fork'
            )
        if again := recorded_world(recording.path, run).again_words:
            raise UsageError(f'{recording.path}: {again}, so a rerun differs anyway')
        word, fingerprint = perception_of(run, perception, graph=True)
        steers = controller_of(run, controller, graph=True)
    images = images or ('all' if info.counts.get(IMAGE) else 'none')
    if images not in IMAGES:
        raise UsageError(f'--images {images}: unknown; known: {", ".join(IMAGES)}')
    out = out or new_folder(DEFAULT_ROOT / f'again-{run.request.run_id}')
    check_new(out)
    console = Console(highlight=False)
    before = perception_words(run.perception, run.fingerprint)
    now = perception_words(word, fingerprint)
    console.print(
        f'rerun of {run.request.run_id}, perception {before}'
        + (f', now {now}' if now != before else '')
        + (f', {run.timing.words}' if run.timing.words else '') + f' -> {out}', soft_wrap=True,
    )
    if run.timing.free:
        console.print(f'a free run, not reproducible: {NOT_REPRODUCIBLE}',
                      soft_wrap=True)
    warn_of_stacks(console, recording.made_on, provenance())
    processes = processes or run.timing.free
    results = rerun([(run, word, steers)], out, images=images, processes=processes)
    result = results[run.request.run_id]
    new = out / run.request.run_id
    row = RunRow.of_run(
        run.request, result, perception=word, bag=new.name,
        sim_s=max(result.last_seq, 0) * CONTROL_PERIOD_NS / 1e9,
    )
    console.print(row_line(row), soft_wrap=True)
    if result.outcome is Outcome.INTERRUPTED:
        raise ToldInterrupt
    if not result.outcome.judged:
        raise InfraError(result.kind, result.who, result.last_seq, result.detail)
    with readable_bags():
        made = open_recording(new)
        skip = () if info.counts.get(IMAGE) and made.info.counts.get(IMAGE) else (IMAGE,)
        topics = compare_bags(recording, made, skip=skip)
    print_comparison(console, topics, 0.0)
    return EQUAL if all(topic.equal for topic in topics) else DIFFERENT


def run_golden(folder: Path, *, update: bool) -> int:
    """Rerun every golden scene, print each comparison, and optionally replace bags that differ.

    Returns:
        Exit code: 0 the same, or replaced; 1 different.
    """
    console = Console(highlight=False)
    bags = golden_bags(folder)
    with readable_bags():
        runs = {bag: open_recording(bag).run for bag in bags}
    for bag, run in runs.items():
        if run.request.run_id != bag.name:
            raise UsageError(f'{bag}: holds run {run.request.run_id}; rename the folder to match')
    if other := stack_differences(folder):
        console.print(
            f'other software stack than the golden bags: {other}', soft_wrap=True, markup=False
        )
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
            console.print(f'{result.bag.name}, perception {words_}:', soft_wrap=True)
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
    for run in runs.values():
        name = run.request.run_id
        result = results.get(name, RunResult(outcome=Outcome.INTERRUPTED))
        if result.outcome is Outcome.INTERRUPTED:
            raise KeyboardInterrupt
        if not result.outcome.judged:
            detail = f'{name}: {result.detail}'
            raise InfraError(result.kind, result.who, result.last_seq, detail)


def _replace_golden(result: GoldenResult) -> None:
    for name in (mcap_path(result.bag).name, METADATA_FILE):
        (result.bag / name).write_bytes((result.again / name).read_bytes())
