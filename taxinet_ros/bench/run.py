"""A run of the benchmark: the chosen subjects, measured in turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.util import find_spec

import cv2

from taxinet_ros.bench.measure import Figure, Progress, Subject, machine_facts, measure
from taxinet_ros.bench.report import Report, find_ratios, make_report
from taxinet_ros.bench.subjects import camera_subjects, loop_subjects
from taxinet_ros.errors import UsageError

Maker = Callable[[ExitStack], list[Subject]]
"""Makes subjects whose resources live until the stack is closed."""

GRAPH = 'graph'


def _graph_subjects(stack: ExitStack) -> list[Subject]:
    if find_spec('rclpy') is None:
        raise UsageError('bench: graph needs ROS 2, and this Python has no rclpy; name the others')
    from taxinet_ros.bench.graph import graph_subjects

    return graph_subjects(stack)


SUBJECTS: dict[str, Maker] = {
    'camera': lambda stack: camera_subjects(),
    'loop': lambda stack: loop_subjects(),
    GRAPH: _graph_subjects,
}
"""Subjects by the word that chooses them."""


def run_subjects(words: Sequence[str], repeats: int, progress: Progress) -> Report:
    """Measure the chosen subjects on one core.

    Args:
        words: the subjects, none for all; the graph adds the loop, for comparison.
        repeats: number of measurements of each.
        progress: called with the progress.

    Raises:
        UsageError: an unknown word (the known ones are listed), no repeats, or a subject that
            cannot be set up.
        InfraError: a run through the graph has no verdict.
    """
    unknown = [word for word in words if word not in SUBJECTS]
    if unknown:
        raise UsageError(f'bench: {unknown[0]!r} is unknown; known: {", ".join(SUBJECTS)}')
    if repeats < 1:
        raise UsageError(f'bench: repeats is {repeats}, needs to be 1 or more')
    chosen = {*(words or SUBJECTS), *(['loop'] if GRAPH in words else [])}
    makers = [SUBJECTS[word] for word in SUBJECTS if word in chosen]
    figures = measure_all(makers, repeats, progress)
    report = make_report(machine_facts(), figures)
    ratios = find_ratios(figures)
    return {**report, 'ratios': ratios} if ratios else report


def measure_all(
    makers: Sequence[Maker], repeats: int, progress: Progress
) -> dict[str, Figure]:
    """Measure subjects in turns, and give back their resources.

    OpenCV uses one thread from here on, for the rest of the process.
    """
    cv2.setNumThreads(1)
    with ExitStack() as stack:
        subjects = [subject for make in makers for subject in make(stack)]
        return measure(subjects, repeats, progress)
