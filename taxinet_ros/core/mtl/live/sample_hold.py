"""Messages of several topics into samples of all signals: the last value of each is held.

A sample is made either whenever one topic speaks, or on a grid of a fixed period; the stamps alone
decide, never a timer, so equal messages in equal order give equal samples. On the grid a sample is
made when the first message from beyond it comes. The first sample waits until every signal has a
value that is fresh. From then on a value that is too old, or whose stamp went back, is no value:
the sample has NaN in its place, which a monitor refuses, and says why.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError

_MAX_FILL = 10_000
"""Most grid samples that one message brings; with more, time has jumped."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Value:
    """What a signal is worth, and since when.

    Attributes:
        value: the number; NaN where there is none.
        stamp_ns: its time [ns].
        trouble: why it is unusable, in a few words, or ''.
    """

    value: float
    stamp_ns: int
    trouble: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """All signals at one time.

    Attributes:
        stamp_ns: its time [ns].
        values: by signal; NaN where there is no usable one.
        troubles: why a signal is unusable, by signal, for those that are.
    """

    stamp_ns: int
    values: Mapping[str, float]
    troubles: Mapping[str, str] = field(default_factory=dict)


class SampleHold:
    """Makes samples of what comes in.

    Args:
        topics: the topic of each signal, by the signal's name.
        sampled_on: topic whose messages each make a sample; '' on a grid.
        period_ns: step of the grid [ns]; 0 where a topic makes the samples.
        max_age_ns: how far a held value's stamp may be from the sample's [ns]; 0: any distance.

    Raises:
        UsageError: not exactly one of ``sampled_on`` and ``period_ns``, or a topic of no signal.
    """

    def __init__(
        self, topics: Mapping[str, str], *, sampled_on: str = '', period_ns: int = 0,
        max_age_ns: int = 0,
    ) -> None:
        if bool(sampled_on) == bool(period_ns) or period_ns < 0 or max_age_ns < 0:
            raise UsageError('samples: name a topic or give a period > 0, and an age >= 0')
        if sampled_on and sampled_on not in topics.values():
            raise UsageError(f'samples: no signal is read from {sampled_on}')
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
        """Wait for a first sample again; usable values stay held, stamps may begin anew."""
        self._held = {name: held for name, held in self._held.items() if not held.trouble}
        self._newest_ns.clear()
        self._next_ns = None
        self._begun = False

    def arrive(
        self, topic: str, stamp_ns: int, readings: Mapping[str, tuple[float, str]]
    ) -> list[Sample]:
        """Take the message of a topic; answer the samples that are complete now, often one.

        Args:
            topic: where it came from.
            stamp_ns: its time [ns].
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
            # What a message from the past says is not the present; nor is what was held before.
            trouble = f'stamps of {topic} went back by {back_ns / NS_PER_S:g} s'
            for name in readings:
                if name in self._held:
                    self._held[name] = replace(self._held[name], trouble=trouble)
            return
        self._newest_ns[topic] = max(stamp_ns, self._newest_ns.get(topic, stamp_ns))
        for name, (value, trouble) in readings.items():
            self._held[name] = Value(value=value, stamp_ns=stamp_ns, trouble=trouble)

    def _sample(self, stamp_ns: int) -> list[Sample]:
        """The sample at a stamp; none while the first one is still waited for."""
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
        """Grid samples before a message's stamp, with what was held before it came."""
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
