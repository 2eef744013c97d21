"""Sample and hold: combines messages of several topics into samples of all signals.

A sample is made either at each message of one topic, or on a grid of a fixed period. Sampling
depends on stamps only, never on a timer, so equal messages in equal order give equal samples. A
grid sample is made at the first message after it. The first sample waits until every signal has a
fresh value. After that, a value that is too old or whose stamp went back is unusable: the sample
has NaN in its place and the reason, and a monitor rejects it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from taxinet_ros.core.types import NS_PER_S

_MAX_FILL = 10_000
"""Maximum number of grid samples made at one message; more means that time has jumped."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Value:
    """Value of a signal with its stamp.

    Attributes:
        value: the number; NaN if there is none.
        stamp_ns: its time [ns].
        trouble: why it is unusable, in a few words, or ''.
    """

    value: float
    stamp_ns: int
    trouble: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """Values of all signals at one time.

    Attributes:
        stamp_ns: its time [ns].
        values: value by signal; NaN if unusable.
        troubles: reason by signal, for unusable signals only.
    """

    stamp_ns: int
    values: Mapping[str, float]
    troubles: Mapping[str, str] = field(default_factory=dict)


class SampleHold:
    """Makes samples from incoming messages.

    Args:
        topics: topic of each signal, by signal name.
        sampled_on: topic whose messages each trigger a sample; '' for a grid.
        period_ns: step of the grid [ns]; 0 with ``sampled_on``.
        max_age_ns: maximum distance between the stamps of a held value and of the sample [ns]; 0:
            unlimited.
    """

    def __init__(
        self, topics: Mapping[str, str], *, sampled_on: str = '', period_ns: int = 0,
        max_age_ns: int = 0,
    ) -> None:
        self._topics = dict(topics)
        self._sampled_on = sampled_on
        self._period_ns = period_ns
        self._max_age_ns = max_age_ns
        self._held: dict[str, Value] = {}
        self._newest_ns: dict[str, int] = {}
        self._next_ns: int | None = None
        self._begun = False

    @property
    def missing(self) -> list[str]:
        """Signals that have no value yet."""
        return [name for name in self._topics if name not in self._held]

    def restart(self) -> None:
        """Wait for a first sample again; usable values stay held, stamps may restart."""
        self._held = {name: held for name, held in self._held.items() if not held.trouble}
        self._newest_ns.clear()
        self._next_ns = None
        self._begun = False

    def arrive(
        self, topic: str, stamp_ns: int, readings: Mapping[str, tuple[float, str]]
    ) -> list[Sample]:
        """Process a message; return the samples that are now complete, usually one.

        Args:
            topic: topic of the message.
            stamp_ns: stamp of the message [ns].
            readings: value and trouble (or '') of every signal that is read from the topic.
        """
        filled = self._fill(stamp_ns) if self._period_ns else []
        self._hold(topic, stamp_ns, readings)
        if topic == self._sampled_on or (self._period_ns and not self._begun):
            return self._sample(stamp_ns)
        return filled

    def _hold(
        self, topic: str, stamp_ns: int, readings: Mapping[str, tuple[float, str]]
    ) -> None:
        back_ns = self._newest_ns.get(topic, stamp_ns) - stamp_ns
        if back_ns > 0 and topic != self._sampled_on:
            # A message from the past is not current, and neither is the held value.
            trouble = f'stamps of {topic} went back by {back_ns / NS_PER_S:g} s'
            for name in readings:
                if name in self._held:
                    self._held[name] = replace(self._held[name], trouble=trouble)
            return
        self._newest_ns[topic] = max(stamp_ns, self._newest_ns.get(topic, stamp_ns))
        for name, (value, trouble) in readings.items():
            self._held[name] = Value(value=value, stamp_ns=stamp_ns, trouble=trouble)

    def _sample(self, stamp_ns: int) -> list[Sample]:
        """Sample at a stamp; none before all signals have a fresh value."""
        stale = {name: self._stale(name, stamp_ns) for name in self._held}
        if not self._begun and (self.missing or any(stale.values())):
            return []
        if not self._begun:
            self._begun = True
            self._next_ns = stamp_ns + self._period_ns
        troubles = {
            name: held.trouble or stale[name]
            for name, held in self._held.items() if held.trouble or stale[name]
        }
        values = {
            name: math.nan if name in troubles else held.value
            for name, held in self._held.items()
        }
        return [Sample(stamp_ns=stamp_ns, values=values, troubles=troubles)]

    def _stale(self, name: str, stamp_ns: int) -> str:
        age_ns = stamp_ns - self._held[name].stamp_ns
        if not self._max_age_ns or abs(age_ns) <= self._max_age_ns:
            return ''
        limit = f'max_age {self._max_age_ns / NS_PER_S:g} s'
        if age_ns > 0:
            return f'{name} is {age_ns / NS_PER_S:.3f} s old ({limit})'
        return f'{name} is stamped {-age_ns / NS_PER_S:.3f} s after the sample ({limit})'

    def _fill(self, stamp_ns: int) -> list[Sample]:
        """Grid samples before a message's stamp, with the values held before the message."""
        if self._next_ns is None or stamp_ns <= self._next_ns:
            return []
        steps = -((self._next_ns - stamp_ns) // self._period_ns)
        first_ns = self._next_ns
        self._next_ns += steps * self._period_ns
        if steps > _MAX_FILL:
            jump = f'time jumped by {(stamp_ns - first_ns) / NS_PER_S:g} s'
            names = self._held
            return [Sample(
                stamp_ns=first_ns, values=dict.fromkeys(names, math.nan),
                troubles=dict.fromkeys(names, jump),
            )]
        return [
            sample for step in range(steps)
            for sample in self._sample(first_ns + step * self._period_ns)
        ]
