"""Sample and hold: combines messages of several topics into samples of all signals.

A sample is made at each message of one topic. Sampling depends on stamps only, never on a timer, so
equal messages in equal order give equal samples. The first sample waits until every signal has a
fresh value. After that, a value that is too old or whose stamp went back is unusable: the sample
has NaN in its place and the reason, and a monitor rejects it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from taxinet_ros.core.types import NS_PER_S


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
        sampled_on: topic whose messages each trigger a sample.
        max_age_ns: maximum distance between the stamps of a held value and of the sample [ns]; 0:
            unlimited.
    """

    def __init__(
        self, topics: Mapping[str, str], *, sampled_on: str, max_age_ns: int = 0
    ) -> None:
        self._topics = dict(topics)
        self._sampled_on = sampled_on
        self._max_age_ns = max_age_ns
        self._held: dict[str, Value] = {}
        self._newest_ns: dict[str, int] = {}
        self._begun = False

    @property
    def missing(self) -> list[str]:
        """Signals that have no value yet."""
        return [name for name in self._topics if name not in self._held]

    def restart(self) -> None:
        """Wait for a first sample again; usable values stay held, stamps may restart."""
        self._held = {name: held for name, held in self._held.items() if not held.trouble}
        self._newest_ns.clear()
        self._begun = False

    def arrive(
        self, topic: str, stamp_ns: int, readings: Mapping[str, tuple[float, str]]
    ) -> Sample | None:
        """Process a message; return the sample that it triggers, if any.

        Args:
            topic: topic of the message.
            stamp_ns: stamp of the message [ns].
            readings: value and trouble (or '') of every signal that is read from the topic.
        """
        self._hold(topic, stamp_ns, readings)
        return self._sample(stamp_ns) if topic == self._sampled_on else None

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

    def _sample(self, stamp_ns: int) -> Sample | None:
        """Sample at a stamp; none before all signals have a fresh value."""
        troubles = {
            name: trouble for name, held in self._held.items()
            if (trouble := held.trouble or self._stale(name, stamp_ns))
        }
        if not self._begun:
            if self.missing or any(self._stale(name, stamp_ns) for name in self._held):
                return None
            self._begun = True
        values = {
            name: math.nan if name in troubles else held.value
            for name, held in self._held.items()
        }
        return Sample(stamp_ns=stamp_ns, values=values, troubles=troubles)

    def _stale(self, name: str, stamp_ns: int) -> str:
        age_ns = stamp_ns - self._held[name].stamp_ns
        if not self._max_age_ns or abs(age_ns) <= self._max_age_ns:
            return ''
        limit = f'max_age {self._max_age_ns / NS_PER_S:g} s'
        if age_ns > 0:
            return f'{name} is {age_ns / NS_PER_S:.3f} s old ({limit})'
        return f'{name} is stamped {-age_ns / NS_PER_S:.3f} s after the sample ({limit})'
