"""A run of the bench: the chosen subjects, all in turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack

import cv2

from taxinet_ros.bench import camera, inference, loop, monitor, physics, samplers
from taxinet_ros.bench.compare import Report, make_report
from taxinet_ros.bench.machine import machine_facts
from taxinet_ros.bench.measure import Progress, Subject, measure
from taxinet_ros.bench.peers import peer_subjects
from taxinet_ros.core.errors import UsageError

ALL = 'all'

SUBJECTS: dict[str, Callable[[], list[Subject]]] = {
    'camera': camera.subjects,
    'inference': inference.subjects,
    'physics': physics.subjects,
    'monitor': monitor.subjects,
    'samplers': samplers.subjects,
    'loop': loop.subjects,
}
"""What can be measured, by the word that chooses it."""


def run_subjects(
    words: Sequence[str], repeats: int, progress: Progress, peers: str | None = None
) -> Report:
    """Measure on one core what the words choose: subjects, or ``all``, which none means too.

    OpenCV keeps to one thread from here on, for all of the process.

    Args:
        words: the subjects.
        repeats: how often each is measured.
        progress: is told how far it is.
        peers: a Python that has other people's monitors, to be measured beside ours.

    Raises:
        UsageError: an unknown word (the known ones are listed), no repeats, or something that
            cannot be set up.
    """
    unknown = [word for word in words if word not in SUBJECTS and word != ALL]
    if unknown:
        known = ', '.join((*SUBJECTS, ALL))
        raise UsageError(f'bench: {unknown[0]!r} is unknown; known: {known}')
    if repeats < 1:
        raise UsageError(f'bench: --repeats is {repeats}, needs to be 1 or more')
    chosen = [word for word in SUBJECTS if not words or ALL in words or word in words]
    cv2.setNumThreads(1)
    subjects = [subject for word in chosen for subject in SUBJECTS[word]()]
    with ExitStack() as stack:
        if peers is not None:
            subjects += stack.enter_context(peer_subjects(peers))
        return make_report(machine_facts(), measure(subjects, repeats, progress))
