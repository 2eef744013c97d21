"""Parts of a control step, and the composed graph in other ways than ``taxinet bench`` measures.

The parts are measured in processor time on the bytes that the graph records, for comparison with
the whole graph. The remainder is the transport: creating, sending, taking and dispatching messages,
and preparing nodes.
"""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from processes import Amounts, folder_bytes, peak_memory
from rclpy.executors import SingleThreadedExecutor

from taxinet_ros.bag.cdr.alignment import Canonical
from taxinet_ros.bag.cdr.image import image_cdr
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.writer import BagWriter
from taxinet_ros.bench.graph import check_domain, scratch, standing_graph
from taxinet_ros.bench.measure import Figure, Subject
from taxinet_ros.bench.report import Ratio
from taxinet_ros.bench.subjects import PERCEPTIONS, SCENARIO, SPEC
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, last_step, signals
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.motion.controller import SteeringGains, steer
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.verdict.judge import Judge
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph

PARTS = (
    'physics', 'rendering', 'encoding', 'inference', 'control', 'monitor', 'recording',
)
"""Parts that are measured separately."""
TRANSPORT = 'transport'
WHOLE = 'whole'
GRAPH = 'graph/composed, network'
"""Name of the figure of the whole graph."""
_NAME = 'tick'
RATIOS = (
    # Below 1 there would be no reason to prefer an experimental executor.
    Ratio(name='default executor / ours, network',
          over='graph/default executor, network', under=GRAPH),
    Ratio(name='default executor / ours, truth',
          over='graph/default executor, truth', under='graph/composed, truth'),
    Ratio(name='recorder without pictures / no recorder, network',
          over=GRAPH, under='graph/no recorder, network'),
    Ratio(name='recorder with pictures / no recorder, network',
          over='graph/with pictures, network', under='graph/no recorder, network'),
)


class _Unrecorded(GraphOptions):
    """Options of a graph without a recorder."""

    def nodes(self) -> dict[str, tuple[Any, dict[str, Any]]]:
        """See :class:`GraphOptions`."""
        nodes = super().nodes()
        del nodes[interface.RECORDER]
        return nodes


def subjects(stack: ExitStack, amounts: Amounts) -> list[Subject]:
    """Runs through composed graphs, and the parts of a control step.

    Args:
        stack: closes the graphs.
        amounts: receives the bytes of a run and the memory of the processes.

    Raises:
        UsageError: the user has set one domain, in which all these graphs would communicate.
    """
    check_domain()

    def options(word: str, images: str = 'none', kind: type = GraphOptions) -> GraphOptions:
        made: GraphOptions = kind(perception=PERCEPTIONS[word], out=scratch(stack), images=images)
        return made

    default = partial(composed_graph, executor=SingleThreadedExecutor)
    composed = standing_graph(stack, options('network'))
    pictures = standing_graph(stack, options('network', images='all'))
    unrecorded = standing_graph(stack, options('network', kind=_Unrecorded))
    apart = standing_graph(
        stack, options('network'), partial(process_graph, logs=scratch(stack))
    )
    amounts['a run without pictures'] = lambda: folder_bytes(composed.bag)
    amounts['a run with pictures'] = lambda: folder_bytes(pictures.bag)
    amounts['memory: graph of processes'] = partial(peak_memory, apart.pids)
    amounts['memory: this process, with all its graphs'] = partial(peak_memory, [os.getpid()])
    return [
        composed.subject('composed, network'),
        tick_subject(lambda: composed.bag),
        standing_graph(stack, options('truth')).subject('composed, truth'),
        apart.subject('processes, network'),
        *(standing_graph(stack, options(word), default).subject(f'default executor, {word}', 2)
          for word in PERCEPTIONS),
        pictures.subject('with pictures, network'),
        unrecorded.subject('no recorder, network'),
    ]


def tick_subject(recorded: Callable[[], Path]) -> Subject:
    """Subject for the parts of a control step, as means over a run.

    Args:
        recorded: returns the bag of a run without pictures; called at the first run.
    """
    perception = make_perception('taxinet')
    gains = SteeringGains()
    made: list[_Recorded] = []

    def drive() -> Mapping[str, int]:
        if not made:
            made.append(_Recorded(recorded()))
        stopwatch = _Stopwatch()
        aircraft, camera = Aircraft(SCENARIO), Camera(SCENARIO)
        last = last_step(SCENARIO)
        judge = Judge([SPEC], last * CONTROL_PERIOD_NS, CONTROL_PERIOD_NS)
        for seq in range(last + 1):
            stamp_ns, state = seq * CONTROL_PERIOD_NS, aircraft.state
            with stopwatch('rendering'):
                image = camera.render(state, stamp_ns)
            with stopwatch('encoding'):
                image_cdr(image, stamp_ns, 'camera_optical')
            with stopwatch('inference'):
                estimate = perception.estimate(image, None)
            with stopwatch('control'):
                command = steer(estimate, gains)
            with stopwatch('monitor'):
                truth = state.tracking_error
                judge.push(stamp_ns, signals(
                    cte_m=truth.cte_m, he_rad=truth.he_rad, x_m=state.x_m,
                    speed_mps=state.speed_mps, estimate=estimate, command=command,
                ))
            with stopwatch('physics'):
                aircraft.advance(command)
        made[0].write(stopwatch)
        return {part: stopwatch.total_ns[part] // (last + 1) for part in PARTS}

    return Subject(name=_NAME, run=drive, warm_ups=1, most=5)


def step_parts(figures: Mapping[str, Figure]) -> dict[str, float]:
    """Break down a control step of the composed graph into its parts [s of processor time].

    Returns:
        Every part, the transport (the remainder) and the whole; empty if it was not measured.
    """
    whole = figures.get(GRAPH)
    if whole is None or whole.cpu_s is None or f'{_NAME}/{PARTS[0]}' not in figures:
        return {}
    step = whole.cpu_s / (last_step(SCENARIO) + 1)
    parts = {part: figures[f'{_NAME}/{part}'].median_s for part in PARTS}
    return {**parts, TRANSPORT: step - sum(parts.values()), WHOLE: step}


class _Stopwatch:
    """Sums the processor time of each part."""

    def __init__(self) -> None:
        self.total_ns = dict.fromkeys(PARTS, 0)

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        start = time.process_time_ns()
        yield
        self.total_ns[part] += time.process_time_ns() - start


class _Recorded:
    """The messages of a run, written repeatedly in the way of the recorder."""

    def __init__(self, bag: Path) -> None:
        self._folder = bag.parent
        messages = list(stored_messages(bag))
        self._topics = tuple({message.topic.name: message.topic for message in messages}.values())
        grouped = itertools.groupby(messages, lambda message: message.stamp_ns)
        self._steps = [(stamp_ns, list(step)) for stamp_ns, step in grouped]
        self._canonical = Canonical(self._topics)

    def write(self, stopwatch: _Stopwatch) -> None:
        """Write them into a bag; its removal is not measured."""
        scratch = Path(tempfile.mkdtemp(prefix='tick-', dir=self._folder))
        with stopwatch('recording'):
            writer = BagWriter(
                scratch / 'run', self._topics, metadata={}, attachments={}, min_free_bytes=0
            )
            for stamp_ns, step in self._steps:
                for topic, _, cdr, _ in step:
                    writer.write(topic.name, self._canonical.message(topic.name, cdr), stamp_ns)
                writer.flush()
            writer.close()
        shutil.rmtree(scratch)
