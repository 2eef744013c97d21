"""``taxinet run --from``: the run of a bag once more, and where it goes another way."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from rich.console import Console

from taxinet_ros.bag.compare import compare_bags
from taxinet_ros.bag.facts import made_on
from taxinet_ros.bag.frames import IMAGE
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.recorded_run import read_run
from taxinet_ros.campaign.lines import row_line
from taxinet_ros.campaign.options import DEFAULT_ROOT, IMAGES, check_new, new_folder
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.cli.bag_compare import DIFFERENT, EQUAL, print_comparison
from taxinet_ros.cli.bag_input import (
    controller_of,
    perception_of,
    perception_words,
    readable_bags,
    warn_of_stacks,
)
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import InfraError, UsageError
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.timing import NOT_REPRODUCIBLE
from taxinet_ros.nodes.rerun import rerun

_TAKEN = frozenset({
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
        if name not in _TAKEN:
            option = names.get(name, '--' + name.replace('_', '-'))
            raise UsageError(f'--from: the bag already says {option}')


def run_again(
    bag: Path, *, perception: str | None, controller: str | None, out: Path | None,
    images: str | None, processes: bool,
) -> int:
    """Run a bag's scenario through the graph again and print how the two runs compare.

    Args:
        bag: a run folder or an ``.mcap`` file.
        perception: word or file; the run's own where None.
        controller: word; the run's own where None.
        out: new folder for the new bag; where None, one below ``bags/``.
        images: as of ``taxinet run``; where None, as the bag has it.
        processes: every node a process of its own.

    Returns:
        Exit code: 0 the same run to the bit, 1 it went another way.

    Raises:
        UsageError: bad input.
        InfraError: the bench broke.
    """
    with readable_bags():
        run, info = read_run(bag), read_info(bag)
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
    warn_of_stacks(console, made_on(info), provenance())
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
        topics = compare_bags(bag, new, skip=skip)
    print_comparison(console, topics, 0.0)
    return EQUAL if all(topic.equal for topic in topics) else DIFFERENT
