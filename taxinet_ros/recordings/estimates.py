"""Estimates that a perception published itself, on a topic of the bag.

A word names them: ``/TOPIC`` of ``taxinet_msgs/TrackingError``; of any type
``/TOPIC:FIELD=UNIT,FIELD=UNIT``, cross-track and heading error, left positive. A minus before a
field turns its sign; ``position.y`` is a field within a field, ``data.0`` an element.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.bag.run.message_values import error_of
from taxinet_ros.core.perception.perception import Perception
from taxinet_ros.core.types import NO_ESTIMATE, NS_PER_S, TrackingError
from taxinet_ros.core.units import ANGLE, LENGTH, UNITS, in_si, kind_words
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.recordings.reader import TRACKING_ERROR, Recording, stamp_of

# The name of a file has a dot, the name of a topic has none.
_WORD = re.compile(r'((?:/\w+)+)(?::(.*))?')
_FIELD = re.compile(r'(-?)([A-Za-z]\w*(?:\.\w+)*)=(\S+)')
_WANTED = ('cross-track', LENGTH), ('heading', ANGLE)
_FORM = 'FIELD=m,FIELD=rad'
_LISTED = 12
_SAME_NS = 1_000
"""Stamps that went through seconds as a float64 are off by a quarter of this."""


class Field(NamedTuple):
    """A number of a message: its names from the outside, and its factor to m or rad."""

    path: tuple[str, ...]
    factor: float


def proposed_word(recording: Recording, topic: str) -> str:
    """The form of the word of a topic that might have estimates, two decimals; '' of others."""
    with contextlib.suppress(UsageError):
        for _, _, message in recording.decoded((topic,)):
            decimals = [name for name, one in _numbers(message) if isinstance(one, float)]
            return f'{topic}:{_FORM}' if len(decimals) > 1 else ''
    return ''


def names_topic(word: str) -> bool:
    """Whether the word of a perception is that of a topic."""
    return _WORD.fullmatch(word) is not None


class RecordedEstimates(Perception):
    """Estimates of a topic; they are not made anew, so :meth:`estimate` has none.

    Attributes:
        topic: their topic.
        fields: cross-track and heading error; () of ``TrackingError``.
    """

    fingerprint, needs_image = '', False

    def __init__(self, word: str) -> None:
        """Read the word.

        Raises:
            UsageError: its fields or units are not understood.
        """
        found = _WORD.fullmatch(word)
        assert found is not None
        self.word, self.topic = word, found[1]
        self.fields = () if found[2] is None else _fields(word, found[2])

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        """No estimate."""
        return NO_ESTIMATE

    def read(self, recording: Recording, pictures: bool, by_log: bool) -> pd.DataFrame:
        """Stamp and time of recording [ns], cross-track [m] and heading error [rad], a row each.

        An estimate that is no number, or not valid, is NaN.

        Args:
            recording: the bag.
            pictures: they belong to pictures, by the stamps of their headers.
            by_log: without pictures, they count at the times of recording.

        Raises:
            UsageError: there are none, or fields and type do not fit.
        """
        kind = recording.types.get(self.topic)
        if kind is None:
            near = near_miss(self.topic, recording.types)
            raise UsageError(
                f'{recording.path}: no such topic: {self.topic} is not in it{near}; taxinet score '
                '--topics lists its topics')
        rows: list[tuple[float, ...]] = []
        for _, log_ns, message in recording.decoded((self.topic,)):
            if not rows:
                self._check(recording, kind, message, pictures, by_log)
            stamp_ns = stamp_of(message) if hasattr(message, 'header') else log_ns
            rows.append((stamp_ns, log_ns, *self._values(message, kind)))
        found = pd.DataFrame(rows, columns=['stamp_ns', 'logged_ns', 'cte_m', 'he_rad'])
        if not np.isfinite(found['cte_m']).any():
            wrong = next((
                f'{".".join(field.path)} is no number of it; those are {_listed(message)}'
                for field in self.fields if rows and _value(message, field.path) is None
            ), f'{len(found)} messages, none with an estimate')
            raise UsageError(f'{recording.path}: {self.topic}, a {kind}: {wrong}')
        return found.astype({'stamp_ns': np.int64, 'logged_ns': np.int64})

    def _check(
        self, recording: Recording, kind: str, message: Any, pictures: bool, by_log: bool
    ) -> None:
        """Refuse a type whose fields are not named, or without a stamp where one is needed."""
        begun = f'{recording.path}: {self.topic} is a {kind}'
        if not self.fields and kind != TRACKING_ERROR:
            raise UsageError(
                f'{begun}: name its cross-track and heading error with their units, left positive '
                f'(a minus before a field turns it), {self.topic}:{_FORM}; its numbers are '
                f'{_listed(message)}')
        if hasattr(message, 'header') or (by_log and not pictures):
            return
        raise UsageError(
            f'{begun}, which has no header, so what it belongs to is unknown; image none '
            'with stamps log compares it with the truth at the time of its recording')

    def _values(self, message: Any, kind: str) -> tuple[float, float]:
        """Cross-track [m] and heading error [rad]; NaN, both, if one is none."""
        if kind == TRACKING_ERROR and not message.valid:
            return math.nan, math.nan
        if self.fields:
            cte, he = (math.nan if value is None else value * field.factor for field in self.fields
                       for value in (_value(message, field.path),))
        else:
            seen = error_of(message)
            cte, he = seen.cte_m, seen.he_rad
        return (cte, he) if math.isfinite(cte) and math.isfinite(he) else (math.nan, math.nan)


def match(
    found: pd.DataFrame, stamps_ns: NDArray[np.int64], name: str, image: str
) -> tuple[NDArray[np.float64], list[str]]:
    """Estimates (n, 2) [m], [rad] of frames with the same stamp, NaN without one; and notes.

    Args:
        found: the estimates, see :meth:`RecordedEstimates.read`.
        stamps_ns: (n,) header stamps of the frames.
        name: of the topic of the estimates.
        image: of the topic of the pictures; '' if the frames are estimates.

    Raises:
        UsageError: none belongs to a frame.
    """
    first = found.drop_duplicates('stamp_ns').sort_values('stamp_ns')
    own = first['stamp_ns'].to_numpy(np.int64)
    after = np.clip(np.searchsorted(own, stamps_ns), 1, len(own) - 1)
    near = np.where(stamps_ns - own[after - 1] <= own[after] - stamps_ns, after - 1, after)
    off_ns = own[near] - stamps_ns
    hit = np.abs(off_ns) <= _SAME_NS
    others = f'pictures on {image}' if image else 'estimates of the first topic'
    if not hit.any():
        raise UsageError(
            f'{name}: none of {len(found)} estimates has the stamp of one of {len(stamps_ns)} '
            f'{others} (the nearest is {np.median(off_ns) / NS_PER_S:+.3f} s off): who publishes '
            'estimates has to copy the stamp of the picture' + (
                '; image none compares them with the truth at their own stamps' if image else ''))
    values = first[['cte_m', 'he_rad']].to_numpy(np.float64)[near]
    values[~hit] = math.nan
    counts = {
        f'{others} have no estimate': int((~hit).sum()),
        f'estimates have the stamp of none of the {others}': len(own) - len(np.unique(near[hit])),
        'estimates are not valid, or no numbers': int(first['cte_m'].isna().sum()),
        'estimates have the stamp of an earlier one and are not used': len(found) - len(first),
    }
    return values, [f'{name}: {count} {words}' for words, count in counts.items() if count]


def _fields(word: str, text: str) -> tuple[Field, ...]:
    """The two fields of a word."""
    parts = [_FIELD.fullmatch(part.strip()) for part in text.split(',')]
    known = [part for part in parts if part is not None]
    if len(parts) != len(_WANTED) or len(known) < len(parts):
        raise UsageError(
            f'perception {word}: expected two fields with their units, cross-track and heading '
            f'error: {word.partition(":")[0]}:{_FORM}')
    found = []
    for part, (what, dimension) in zip(known, _WANTED, strict=True):
        sign, path, unit = part.groups()
        if unit not in UNITS or UNITS[unit].dimension != dimension:
            raise UsageError(
                f'perception {word}: {path} is the {what} error, and its unit {unit}; expected '
                f'{kind_words(dimension)}')
        found.append(Field(tuple(path.split('.')), in_si(f'{sign}1', unit)))
    return tuple(found)


def _members(value: Any) -> Iterator[tuple[str, Any]]:
    """Names and values within a message, or an array."""
    names = getattr(value, '__dataclass_fields__', None)
    if names is not None:
        yield from ((name, getattr(value, name)) for name in names if name != '__msgtype__')
    elif isinstance(value, np.ndarray | list):
        yield from ((str(number), one) for number, one in enumerate(value))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool)


def _listed(message: Any) -> str:
    """The numbers of a message by their names, as far as a line takes them."""
    names = [name for name, _ in islice(_numbers(message), _LISTED + 1)]
    return (', '.join(names[:_LISTED]) or 'none') + (', …' if len(names) > _LISTED else '')


def _numbers(value: Any, before: str = '') -> Iterator[tuple[str, Any]]:
    """All numbers of a message by their names, without those of its header."""
    for name, one in _members(value):
        if before or name != 'header':
            if _is_number(one):
                yield f'{before}{name}', one
            yield from _numbers(one, f'{before}{name}.')


def _value(message: Any, path: tuple[str, ...]) -> float | None:
    """A number of a message; None if it has none of that name."""
    for name in path:
        message = dict(_members(message)).get(name)
    return float(message) if _is_number(message) else None
