"""Timings beside those of ``taxinet bench``, measured in turns on one core.

camera: making cameras and textures. inference, physics, samplers: parts of a run. monitor: online
and offline, with ``--peers`` those of others too. start-up: until a command's first step is on
disk, and until a node is seen. campaign: wall time of a run by number of workers. graph: parts of a
control step, and the composed graph with rclpy's executor, with pictures, and without a recorder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from typing import Any

from common import leave, one_of, options, page_console

import components
import monitors
from processes import Amounts
from rich.console import Console

from taxinet_ros.bench.measure import Subject, machine_facts
from taxinet_ros.bench.report import find_ratios, make_report
from taxinet_ros.bench.run import Maker, measure_all
from taxinet_ros.cli.bench.commands import print_report, time_text
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.cli.show import print_table

ALONE: dict[str, Callable[[], list[Subject]]] = {
    'camera': components.camera_subjects,
    'inference': components.inference_subjects,
    'physics': components.physics_subjects,
    'samplers': components.sampler_subjects,
    'monitor': monitors.subjects,
}
WITH_ROS = {'graph': 'control_step', 'start-up': 'start_up', 'campaign': 'campaign'}
"""Modules of the subjects that need ROS, by word."""
PEERS = 'monitor'


def measure_subjects(
    words: Sequence[str], repeats: int, progress: Callable[[int, int], None],
    peers: str | None = None,
) -> dict[str, Any]:
    """Measure subjects in turns.

    Args:
        words: subjects; none for all.
        repeats: number of measurements of each, fewer of those that take seconds.
        progress: called with the progress.
        peers: Python with the monitors of others.

    Returns:
        ``machine``, ``figures``; where measured ``ratios``, ``tick`` and ``amounts``.
    """
    chosen = [word for word in (*ALONE, *WITH_ROS) if word in words or not words]
    amounts: Amounts = {}
    sizes: dict[str, float] = {}
    makers: list[Maker] = [partial(_make, word, amounts, peers) for word in chosen]
    figures = measure_all([*makers, partial(_weigh, amounts, sizes)], repeats, progress)
    report = make_report(machine_facts(), figures)
    sections: dict[str, Any] = {'amounts': sizes}
    if 'graph' in chosen:
        control_step = import_module('control_step')
        sections['ratios'] = find_ratios(figures, control_step.RATIOS)
        sections['tick'] = control_step.step_parts(figures)
    return {**report, **{name: section for name, section in sections.items() if section}}


def _make(word: str, amounts: Amounts, peers: str | None, stack: ExitStack) -> list[Subject]:
    if word in WITH_ROS:
        found: list[Subject] = import_module(WITH_ROS[word]).subjects(stack, amounts)
        return found
    others = stack.enter_context(monitors.peer_subjects(peers)) if peers and word == PEERS else []
    return [*ALONE[word](), *others]


def _weigh(amounts: Amounts, sizes: dict[str, float], stack: ExitStack) -> list[Subject]:
    """Have amounts taken before what they are of is given back."""
    stack.callback(lambda: sizes.update({name: size() for name, size in amounts.items()}))
    return []


def show(report: dict[str, Any]) -> None:
    """Print the figures, and what follows from them."""
    print_report(report)
    console = page_console()
    if tick := report.get('tick'):
        whole = list(tick.values())[-1]
        print_table(console, ('a control step of the composed graph', 'cpu', 'share'), [
            [part, time_text(time_s), f'{time_s / whole:.0%}'] for part, time_s in tick.items()
        ])
    if amounts := report.get('amounts'):
        print_table(console, ('amount', ''), [
            [name, f'{size / 1e6:.1f} MB'] for name, size in amounts.items()
        ])


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = options(__doc__, repeats=40)
    known = (*ALONE, *WITH_ROS)
    parser.add_argument('subjects', nargs='*', type=one_of(known), metavar='SUBJECT',
                        help=f'{", ".join(known)}; none for all, which takes minutes')
    parser.add_argument('--peers', metavar='PYTHON',
                        help='Python with rtamt, SENTIL or metric-temporal-logic '
                        '(tests/core/mtl/oracles.txt): measure them beside our monitors')
    given = parser.parse_args(words)
    if given.peers and given.subjects and PEERS not in given.subjects:
        parser.error(f'--peers needs the subject {PEERS}')
    with stage_bars(Console(stderr=given.json)) as bars:
        report = measure_subjects(
            given.subjects, given.repeats, partial(bars, 'measuring'), given.peers
        )
    print(json.dumps(report, indent=2)) if given.json else show(report)
    return 0


if __name__ == '__main__':
    leave(main)
