"""The simplex switch between controller and aircraft: what happens after a monitor's alarm.

An advanced controller that cannot be verified runs under a monitor; on an alarm a simple one takes
over (Sha, *Using Simplicity to Control Complexity*, IEEE Software 18(4), 2001; ASTM F3269 calls it
run-time assurance). The switch latches: within a run there is no way back.

A monitored controller is one word, as a world with its camera is: ``CONTROLLER+MONITOR+FALLBACK``,
for instance ``steering+original+stop``. So it is recorded, resumed and run again like any other.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.assurance.monitor import (
    CalibratedMonitor,
    RuntimeMonitor,
    Seen,
    check_monitor,
    make_monitor,
)
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS, rolling_on
from taxinet_ros.core.motion import controller as plain
from taxinet_ros.core.motion.controller import STEERING, STOP, Controller, SteeringGains
from taxinet_ros.core.perception.perception import (
    GroundTruth,
    Perception,
    check_perception,
    make_perception,
)
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.sensors import Measured
from taxinet_ros.core.types import NS_PER_S, TaxiCommand, TrackingError, step_stamp_ns, time_words
from taxinet_ros.core.user_code import NO_NODE_HERE, is_node_elsewhere
from taxinet_ros.errors import UsageError

STOPPING: Final = 'stop'
SLOW: Final = 'slow'
WATCH: Final = 'watch'
SECOND: Final = 'second'
FALLBACKS: Final = (STOPPING, SLOW, 'second:PERCEPTION', WATCH)
"""What may follow an alarm: full brakes; a crawl; a second perception; or nothing."""
SLOW_MPS: Final = 1.5
"""Speed after an alarm with :data:`SLOW` [m/s]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Parts:
    """Words of a monitored controller."""

    controller: str
    monitor: str
    fallback: str

    @property
    def word(self) -> str:
        """One word for all."""
        return f'{self.controller}+{self.monitor}+{self.fallback}'

    @property
    def second(self) -> str:
        """Word of the second perception; ''."""
        kind, _, name = self.fallback.partition(':')
        return name if kind == SECOND else ''


def parts_of(word: str) -> Parts | None:
    """Parts of a word; None for a controller without monitor."""
    parts = word.rsplit('+', 2)
    if len(parts) != 3 or is_node_elsewhere(word):
        return None
    found = Parts(controller=parts[0], monitor=parts[1], fallback=parts[2])
    return found if _is_fallback(found.fallback) else None


def monitored(controller: str, monitor: str | None, fallback: str | None) -> str:
    """Word of a controller under a monitor.

    Args:
        controller: word of the controller.
        monitor: word of the monitor; None for none.
        fallback: one of :data:`FALLBACKS`; None for the brakes.

    Raises:
        UsageError: one goes without the other, or cannot be used.
    """
    if monitor is None:
        if fallback is not None:
            raise UsageError(f'fallback {fallback}: no effect without a monitor')
        return controller
    if parts_of(controller) is not None:
        raise UsageError(f'monitor {monitor}: controller {controller} names one already')
    if is_node_elsewhere(controller):
        raise UsageError(
            f'monitor {monitor}: the switch is in our controller node, and controller '
            f'{controller} is another node'
        )
    chosen = fallback or STOPPING
    if not _is_fallback(chosen):
        raise UsageError(f'fallback {chosen}: unknown; known: {", ".join(FALLBACKS)}')
    if '+' in monitor or '+' in chosen:
        raise UsageError(f'monitor {monitor}, fallback {chosen}: + is not allowed in them')
    return Parts(controller=controller, monitor=monitor, fallback=chosen).word


def _is_fallback(word: str) -> bool:
    kind, colon, name = word.partition(':')
    return bool(name) if kind == SECOND else word in (STOPPING, SLOW, WATCH) and not colon


@dataclass(frozen=True, kw_only=True, slots=True)
class Alarm:
    """The first alarm of a run.

    Attributes:
        step: control step.
        reason: name of the check.
        score: its score over its threshold.
        period_ns: control period [ns].
    """

    step: int
    reason: str
    score: float
    period_ns: int = CONTROL_PERIOD_NS

    @property
    def at_s(self) -> float:
        """Simulated time [s]."""
        return step_stamp_ns(self.step, self.period_ns) / NS_PER_S

    def __str__(self) -> str:
        return f'{self.reason} at {time_words(self.at_s)} ({self.score:.2f} times its threshold)'


class Assured(Controller):
    """A controller under a monitor, with what takes over on an alarm.

    Attributes:
        alarm: the run's first alarm; None if there was none.
    """

    needs_image = True

    def __init__(
        self, parts: Parts, inner: Controller, monitor: RuntimeMonitor, second: Perception | None
    ) -> None:
        """Put the parts together.

        Args:
            parts: their words.
            inner: the controller.
            monitor: the monitor.
            second: the second perception, where the fallback is one.

        Raises:
            UsageError: the second perception uses no picture.
        """
        if second is not None and not second.needs_image:
            raise UsageError(f'fallback {parts.fallback}: it sees no picture; name a network')
        self._fallback = parts.fallback
        second_word = '' if second is None else second.word
        self.word = replace(
            parts, controller=inner.word, monitor=monitor.word,
            fallback=f'{SECOND}:{second_word}' if second is not None else parts.fallback,
        ).word
        self.fingerprint = _digest(
            inner.fingerprint, monitor.fingerprint, '' if second is None else second.fingerprint,
            parts.fallback.partition(':')[0],
        )
        self._inner, self._monitor, self._second = inner, monitor, second
        self._sensing = [part for part in (inner, second) if part and part.needs_sensors]
        self.needs_sensors = bool(self._sensing)
        self.alarm: Alarm | None = None
        self._image: NDArray[np.uint8] | None = None
        self._last = STOP
        self._step, self._period_ns = 0, CONTROL_PERIOD_NS

    def begin(self, scenario: Scenario | None = None) -> None:
        """Reset every part."""
        scenario = scenario or Scenario()
        self.alarm, self._image, self._step = None, None, 0
        self._period_ns = scenario.period_ns
        self._last = rolling_on(scenario.speed_mps)
        self._inner.begin(scenario)
        self._monitor.begin(scenario)
        if self._second is not None:
            self._second.begin(scenario.rig)

    def doubts(self, perception: Perception) -> list[str]:
        """Warnings on its monitor with a perception (:meth:`.Calibration.doubts`)."""
        watching = self._monitor
        if not isinstance(watching, CalibratedMonitor):
            return []
        return watching.calibration.doubts(
            watching.word, perception.word, perception.fingerprint
        )

    def see(self, image: NDArray[np.uint8]) -> None:
        """Take the frame of the next estimate."""
        self._image = image

    def sense(self, measured: Measured) -> None:
        """Pass on what the sensors deliver."""
        for part in self._sensing:
            part.sense(measured)

    def command(self, estimate: TrackingError) -> TaxiCommand:
        """Judge the estimate, and return the command of whoever is in charge.

        The second perception sees every frame from the alarm on, and is not monitored itself.

        Raises:
            UserCodeError: user code failed.
        """
        image, self._image = self._image, None
        if image is None:
            raise ValueError('a monitor judges an estimate together with its frame')
        if self.alarm is None:
            scores = self._monitor.scores(
                Seen(image=image, estimate=estimate, command=self._last)
            )
            self.alarm = alarm_of(scores, self._step, self._period_ns)
        if self.alarm is not None and self._second is not None:
            estimate = self._second.estimate(image, None)
        command = self._inner.command(estimate)
        if self.alarm is not None and self._fallback == STOPPING:
            command = STOP
        elif self.alarm is not None and self._fallback == SLOW:
            command = replace(command, speed_mps=min(command.speed_mps, SLOW_MPS))
        self._last = command
        self._step += 1
        return command


def alarm_of(
    scores: Mapping[str, float], step: int, period_ns: int = CONTROL_PERIOD_NS
) -> Alarm | None:
    """The alarm of the largest score of a control step; None if that is below 1."""
    reason = max(scores, key=lambda name: scores[name])
    alarm = Alarm(step=step, reason=reason, score=scores[reason], period_ns=period_ns)
    return alarm if alarm.score >= 1 else None


def _digest(*parts: str) -> str:
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def make_controller(word: str, gains: SteeringGains) -> Controller:
    """As :func:`.controller.make_controller`, also for a controller under a monitor.

    Raises:
        UsageError: unknown word, or a part that cannot be used.
    """
    parts = parts_of(word)
    if parts is None:
        return plain.make_controller(word, gains)
    _check_parts(parts)
    return Assured(
        parts, plain.make_controller(parts.controller, gains), make_monitor(parts.monitor),
        make_perception(parts.second) if parts.second else None,
    )


def check_controller(word: str, gains: Mapping[str, float] = {}, *, graph: bool = False) -> str:
    """As :func:`.controller.check_controller`, also for a controller under a monitor.

    Raises:
        UsageError: as :func:`make_controller`; or gains are set for a controller without gains.
    """
    parts = parts_of(word)
    if parts is None:
        return plain.check_controller(word, gains, graph=graph)
    _check_parts(parts)
    if gains:
        raise UsageError(f'steering.{min(gains)}: cannot be set together with a monitor')
    return _digest(
        plain.check_controller(parts.controller), check_monitor(parts.monitor),
        check_perception(parts.second) if parts.second else '', parts.fallback.partition(':')[0],
    )


def _check_parts(parts: Parts) -> None:
    """Refuse a part that is a node."""
    for word in (parts.controller, parts.second):
        if is_node_elsewhere(word):
            raise UsageError(f'{parts.word}: {word} {NO_NODE_HERE}')
    if parts.second == GroundTruth.word:
        raise UsageError(f'fallback {parts.fallback}: it sees no picture; name a network')


def named_parts(word: str) -> bool:
    """Whether a recorded word names parts that are found by name alone, without a path."""
    from taxinet_ros.core.assurance.monitor import is_monitor_name
    from taxinet_ros.core.perception.perception import perception_names
    from taxinet_ros.registry import CONTROLLERS, names

    parts = parts_of(word)
    return parts is not None and (
        parts.controller in names(CONTROLLERS) and is_monitor_name(parts.monitor)
        and (not parts.second or parts.second in perception_names())
    )


__all__ = [
    'FALLBACKS', 'SLOW_MPS', 'STEERING', 'WATCH', 'Alarm', 'Assured', 'Parts', 'check_controller',
    'make_controller', 'monitored', 'named_parts', 'parts_of',
]
