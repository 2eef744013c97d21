"""Bags as command input: select run, perception and controller; map errors to exit codes."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from rich.console import Console

from taxinet_ros.bag.errors import (
    BagCorrupt,
    BagError,
    BagForeign,
    BagTruncated,
    BagWriteError,
)
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.topics import SCENARIO
from taxinet_ros.core.assurance.switch import check_controller, named_parts
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.perception.perception import check_perception, perception_names
from taxinet_ros.core.provenance import Provenance, differences
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.registry import CONTROLLERS, names
from taxinet_ros.trials.past_runs.judged_run import BagPlaces


def exit_code_of(bag: Path, work: Callable[[], int]) -> int:
    """Run ``work`` on ``bag``; turn a bag error into one line and an exit code.

    Returns:
        The result of ``work``; after an error INCOMPLETE if part of the bag is recoverable, USAGE
        if nothing is, INFRA if the output could not be written.
    """
    try:
        return work()
    except BagWriteError as error:
        return _complain(str(error), ExitCode.INFRA)
    except (BagTruncated, BagCorrupt) as error:
        save = f'save the intact part: taxinet bag recover {shlex.quote(str(bag))} --out NEW'
        return _complain(f'{error}; {save}', ExitCode.INCOMPLETE)
    except BagError as error:
        return _complain(str(error), ExitCode.USAGE)


def _complain(text: str, code: int) -> int:
    print(f'taxinet: error: {" ".join(text.split())}', file=sys.stderr)
    return code


@contextlib.contextmanager
def readable_bags() -> Iterator[None]:
    """Turn an unreadable bag into a usage error, since exit code 1 means a difference here."""
    try:
        yield
    except BagError as error:
        raise UsageError(str(error)) from error


def one_run(bag: Path, run: str | None) -> Recording:
    """Recording of one run, in the recorder node's form.

    Args:
        bag: a bag's folder or an ``.mcap`` file, from any recorder.
        run: which run, if it holds several.

    Raises:
        UsageError: it holds several runs and none is named, or none has that name.
        BagError: it cannot be read, or is damaged and from another recorder.
    """
    recording = open_recording(bag)
    if recording.plain or not recording.runs:
        if run is not None:
            recording.choose(run)
        return recording
    chosen = recording.choose(run)
    if chosen.scenario is None:
        raise UsageError(f'{bag}: run {chosen.name}: no message on {SCENARIO}')
    if chosen.unclear:
        raise BagForeign(f'{bag}: run {chosen.name}: {chosen.unclear}', path=bag)
    for error in recording.damage:
        raise error
    return recording[chosen.name]


@contextlib.contextmanager
def readable_run(bag: Path, run: str | None) -> Iterator[Recording]:
    """:func:`one_run` for commands that repeat the run, where exit code 1 means a difference.

    Raises:
        UsageError: it cannot be read, or its campaign records another run at this place.
    """
    with readable_bags():
        whole = one_run(bag, run)
        if not whole.name:
            BagPlaces().check(whole, whole=whole.complete)
        yield whole


def warn_of_stacks(console: Console, *stacks: Provenance) -> None:
    """Warn in one line if compared results come from different machines, libraries or code.

    Args:
        console: console to print to.
        stacks: provenance of each result; empty if unknown.
    """
    if not all(stacks):
        line = 'processor and versions of some of these results are unknown'
    elif found := differences(*stacks):
        line = f'made on different machines or versions: {found}'
    else:
        return
    console.print(f'warning: {line}')


def perception_of(
    run: RecordedRun, asked: str | None, *, graph: bool = False
) -> tuple[str, str]:
    """Return word or file of the perception to use, and its fingerprint.

    Args:
        run: the recorded run.
        asked: the user's choice instead of the run's own, or None.
        graph: whether it is for a graph, where an external node is allowed too.

    Raises:
        UsageError: the run's own is a file of unknown path; or an invalid word.
    """
    word = asked or run.perception
    if not asked and word not in perception_names():
        of = f' of sha256 {run.fingerprint[:12]}…' if run.fingerprint else ''
        kind = f'{word!r}{of}, not a shipped one' if word else 'not told'
        raise UsageError(
            f"{run.request.run_id}: the run's own perception is {kind}; name one with --perception"
        )
    return word, check_perception(word, graph=graph)


def controller_of(run: RecordedRun, asked: str | None, *, graph: bool = False) -> str:
    """Return the word of the controller to use.

    Args:
        run: the recorded run.
        asked: the user's choice instead of the run's own, or None.
        graph: whether it is for a graph, where an external node is allowed too.

    Raises:
        UsageError: the run's own is user code of unknown path; or an invalid word.
    """
    if asked:
        check_controller(asked, graph=graph)
        return asked
    if run.controller in names(CONTROLLERS) or named_parts(run.controller):
        check_controller(run.controller, graph=graph)
        return run.controller
    if run.controller:
        of = f' of sha256 {run.controller_fingerprint[:12]}…' if run.controller_fingerprint else ''
        raise UsageError(
            f"{run.request.run_id}: the run's own controller is {run.controller!r}{of}; name one "
            'with --controller'
        )
    return STEERING


def perception_words(word: str, fingerprint: str) -> str:
    """Display name of a perception."""
    return f'{word} ({fingerprint[:8]})' if fingerprint else word
