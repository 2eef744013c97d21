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
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.rewrite.frames import IMAGE
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import recorded_world
from taxinet_ros.campaign.options import DEFAULT_ROOT, IMAGES, check_new, new_folder
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.summary import row_line
from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL, print_comparison
from taxinet_ros.cli.bag.input import (
    controller_of,
    perception_of,
    perception_words,
    readable_bags,
    warn_of_stacks,
)
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.outcome import Outcome, RunResult
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.provenance import provenance
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes.graph.replay import rerun

_TAKEN_BESIDE_FROM = frozenset({
    'bag', 'run_id', 'perception', 'perception_cmd', 'controller', 'controller_cmd', 'out',
    'images', 'processes',
})
"""Options of ``taxinet run`` that mean something beside ``--from``."""


def check_options(given: Iterable[str]) -> None:
    """Refuse options that would make it another run.

    Args:
        given: parameters of ``taxinet run`` that stand on the command line.

    Raises:
        UsageError: one of them makes no sense with ``--from``.
    """
    names = {'settings': '--set', 'scenario': 'SCENARIO', 'free': 'whether --free'}
    for name in given:
        if name not in _TAKEN_BESIDE_FROM:
            option = names.get(name, '--' + name.replace('_', '-'))
            raise UsageError(f'--from: the bag already says {option}')


def run_again(
    recording: Recording, *, perception: str | None, controller: str | None, out: Path | None,
    images: str | None, processes: bool,
) -> int:
    """Run a bag's scenario through the graph again and print how the two runs compare.

    Args:
        recording: of the run.
        perception: word or file; the run's own where None.
        controller: word; the run's own where None.
        out: new folder for the new bag; where None, one below ``bags/``.
        images: as of ``taxinet run``; where None, as the bag has it.
        processes: every node a process of its own.

    Returns:
        Exit code: 0 the same run to the bit, 1 they differ.

    Raises:
        UsageError: bad input.
        InfraError: the bench broke.
    """
    with readable_bags():
        run, info = recording.run, recording.info
        recorded_world(recording)
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
        f'once more {run.request.run_id}, perception {before}'
        + (f', now {now}' if now != before else '')
        + (f', {run.timing.words}' if run.timing.words else '') + f' -> {out}', soft_wrap=True,
    )
    if run.timing.free:
        console.print(f'a free run, which need not come out the same: {NOT_REPRODUCIBLE}',
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
        raise KeyboardInterrupt
    if not result.outcome.judged:
        raise InfraError(result.kind, result.who, result.last_seq, result.detail)
    with readable_bags():
        counts = read_info(new).counts
        skip = () if info.counts.get(IMAGE) and counts.get(IMAGE) else (IMAGE,)
        topics = compare_bags(recording.path, new, skip=skip)
    print_comparison(console, topics, 0.0)
    return EQUAL if all(topic.equal for topic in topics) else DIFFERENT


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
        runs = {bag: open_recording(bag).run for bag in bags}
    for bag, run in runs.items():
        if run.request.run_id != bag.name:
            raise UsageError(f'{bag}: holds run {run.request.run_id}; name the folder so')
    if other := stack_differences(folder):
        console.print(f'another stack than theirs: {other}', soft_wrap=True, markup=False)
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
            console.print(f'{len(changed)} of {len(results)} golden bags recorded anew')
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
