"""A run of the benchmark: the chosen subjects, measured in turns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib import import_module
from importlib.util import find_spec
from typing import cast

import cv2

from taxinet_ros.bench.measure import Progress, Subject, machine_facts, measure
from taxinet_ros.bench.processes import Amounts
from taxinet_ros.bench.report import Report, find_ratios, make_report
from taxinet_ros.bench.subjects import closed_loop, components, monitor
from taxinet_ros.bench.subjects.closed_loop import step_parts
from taxinet_ros.bench.subjects.monitor import peer_subjects
from taxinet_ros.errors import UsageError

ALL = 'all'

Standing = Callable[[ExitStack, Amounts], list[Subject]]
"""Makes subjects whose resources live until the stack is closed, and may add amounts."""

SUBJECTS: dict[str, Callable[[], list[Subject]]] = {
    'camera': components.camera_subjects,
    'inference': components.inference_subjects,
    'physics': components.physics_subjects,
    'monitor': monitor.subjects,
    'samplers': components.sampler_subjects,
    'loop': closed_loop.subjects,
}
"""Subjects that need no ROS, by the word that chooses them."""

GRAPH, START_UP, CAMPAIGN = 'graph', 'start-up', 'campaign'


def _standing(module: str) -> Standing:
    """The subjects of a module that needs ROS, imported on first use."""
    name = f'taxinet_ros.bench.subjects.{module}'
    return lambda stack, amounts: cast(
        'list[Subject]', import_module(name).subjects(stack, amounts)
    )


WITH_ROS: dict[str, Standing] = {
    GRAPH: _standing('graph'), START_UP: _standing('start_up'), CAMPAIGN: _standing('campaign'),
}
"""Subjects that need ROS; ``all`` includes them except the campaign, which takes minutes."""


def run_subjects(
    words: Sequence[str], repeats: int, progress: Progress, peers: str | None = None
) -> Report:
    """Measure the chosen subjects on one core; no words mean ``all``.

    OpenCV uses one thread from here on, for the rest of the process.

    Args:
        words: the subjects; the graph adds the loop, for comparison.
        repeats: number of measurements of each.
        progress: called with the progress.
        peers: Python executable with third-party monitors, to be compared with ours.

    Raises:
        UsageError: an unknown word (the known ones are listed), no repeats, or a subject that
            cannot be set up.
        InfraError: a run through the graph has no verdict, or a command failed.
    """
    chosen, left_out = _choose(words)
    if repeats < 1:
        raise UsageError(f'bench: --repeats is {repeats}, needs to be 1 or more')
    cv2.setNumThreads(1)
    subjects = [subject for word in chosen if word in SUBJECTS for subject in SUBJECTS[word]()]
    amounts: Amounts = {}
    with ExitStack() as stack:
        for word in chosen:
            if word in WITH_ROS:
                subjects += WITH_ROS[word](stack, amounts)
        if peers is not None:
            subjects += stack.enter_context(peer_subjects(peers))
        figures = measure(subjects, repeats, progress)
        sections = {
            'tick': step_parts(figures),
            'ratios': find_ratios(figures),
            'amounts': {name: tell() for name, tell in amounts.items()},
            'left_out': left_out,
        }
    report = make_report(machine_facts(), figures)
    return report | {name: section for name, section in sections.items() if section}


def _choose(words: Sequence[str]) -> tuple[list[str], dict[str, str]]:
    """The subjects to measure, and the reason for each subject of ``all`` that is left out."""
    known = (*SUBJECTS, *WITH_ROS)
    unknown = [word for word in words if word not in known and word != ALL]
    if unknown:
        raise UsageError(f'bench: {unknown[0]!r} is unknown; known: {", ".join((*known, ALL))}')
    wanted = set(words)
    if not words or ALL in words:
        wanted |= set(known) - {CAMPAIGN}
    if GRAPH in wanted:
        wanted.add('loop')
    left_out = {}
    if find_spec('rclpy') is None:
        named = [word for word in words if word in WITH_ROS]
        if named:
            raise UsageError(f'bench: {named[0]} needs ROS 2, and this Python has no rclpy')
        left_out = {word: 'no rclpy' for word in WITH_ROS if word in wanted}
    return [word for word in known if word in wanted and word not in left_out], left_out
