"""``taxinet run --from``: run a recorded scenario again and compare."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.rewrite.frames import CAMERA2, IMAGE
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import recorded_world
from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL, print_comparison
from taxinet_ros.cli.bag.input import warn_of_stacks
from taxinet_ros.cli.show import line_console
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.types import step_stamp_ns
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.nodes.graph.replay import rerun
from taxinet_ros.processes.interrupts import ToldInterrupt
from taxinet_ros.trials.options import DEFAULT_ROOT, IMAGES, check_new, new_folder
from taxinet_ros.trials.past_runs.repeated_run import (
    controller_of,
    perception_of,
    perception_words,
    readable_bags,
)
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import row_line

_TAKEN_BESIDE_FROM = frozenset({
    'bag', 'run_id', 'perception', 'controller', 'out', 'images', 'processes',
})
"""Options of ``taxinet run`` allowed with ``--from``."""


def check_options(given: Iterable[str]) -> None:
    """Refuse given parameters of ``taxinet run`` that contradict the recorded run."""
    names = {
        'settings': '--set', 'program': 'SCENARIO', 'free': 'whether --free', 'specs': '--spec',
        'bounds': '--bound', 'rates': '--rate',
    }
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
    console = line_console()
    before = perception_words(run.perception, run.fingerprint)
    now = perception_words(word, fingerprint)
    console.print(
        f'rerun of {run.request.run_id}, perception {before}'
        + (f', now {now}' if now != before else '')
        + (f', {run.timing.words}' if run.timing.words else '') + f' -> {out}',
    )
    if run.timing.free:
        console.print(f'a free run, not reproducible: {NOT_REPRODUCIBLE}')
    warn_of_stacks(console, recording.made_on, provenance())
    processes = processes or run.timing.free
    results = rerun([(run, word, steers)], out, images=images, processes=processes)
    result = results[run.request.run_id]
    new = out / run.request.run_id
    row = RunRow.of_run(
        run.request, result, perception=word, bag=new.name,
        sim_s=step_stamp_ns(max(result.last_seq, 0), run.request.scenario.period_ns) / 1e9,
    )
    console.print(row_line(row))
    if result.outcome is Outcome.INTERRUPTED:
        raise ToldInterrupt
    if not result.outcome.judged:
        raise InfraError(result.kind, result.who, result.last_seq, result.detail)
    with readable_bags():
        made = open_recording(new)
        both = info.counts.get(IMAGE) and made.info.counts.get(IMAGE)
        skip = () if both else (IMAGE, CAMERA2)
        topics = compare_bags(recording, made, skip=skip)
    print_comparison(console, topics, 0.0)
    return EQUAL if all(topic.equal for topic in topics) else DIFFERENT
