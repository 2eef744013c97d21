"""A recorded run to be repeated: which run of a bag, and with which perception and controller."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from taxinet_ros.bag.errors import (
    BagError,
    BagForeign,
)
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.topics import SCENARIO
from taxinet_ros.core.assurance.switch import check_controller, named_parts
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.perception.perception import check_perception, perception_names
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import CONTROLLERS, names
from taxinet_ros.trials.past_runs.recorded_campaign import BagPlaces


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
            f"{run.request.run_id}: the run's own perception is {kind}; name one as perception"
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
            'as controller'
        )
    return STEERING


def perception_words(word: str, fingerprint: str) -> str:
    """Display name of a perception."""
    return f'{word} ({fingerprint[:8]})' if fingerprint else word
