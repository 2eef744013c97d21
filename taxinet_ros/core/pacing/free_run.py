"""Bookkeeping of free runs, in which simulated time follows the wall clock without waiting.

The simulator has one per run, instead of a lockstep. A frame is answered by the first command that
names it, at any time; the command for the newest frame applies from the next frame on. A frame is
settled once a newer one has a command: later answers to it are ignored, so monitor and recorder
know which frames stay unanswered. Monitor and recorder are not under test: the simulator waits for
them if their queues would overflow, and the frame then counts as late. Wall-clock times are passed
as arguments.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from taxinet_ros.core.pacing.lockstep import WINDOW, Lockstep

_STEP_S = 0.1
_AT_ONCE, _UNFINISHED = 2, 4
"""Maximum frames settled per step, and maximum frames settled but not yet judged and recorded."""

_LATE_SHARE = 0.1
"""A frame published late by more than this share of a step is an overrun."""

_LIST_WORDS = ('applied', 'frame_s', 'estimate_s', 'command_s', 'estimate_seq', 'command_seq')


@dataclass(kw_only=True)
class FreeRunAccount:
    """Timing record of a free run, by frame; wall-clock times [s], 0 at the first frame.

    Attributes:
        applied: number of the frame whose command applied from each frame to the next; -1: none.
        frame_s: time of publication of each frame.
        estimate_s, command_s: arrival times of the answers; NaN if there was none.
        estimate_seq, command_seq: newest frame at that time; -1 if there was none.
        overruns: number of frames published late, by more than a tenth of a step.
        stale: number of answers that arrived after one to a newer frame and had no effect.
    """

    applied: list[int] = field(default_factory=list)
    frame_s: list[float] = field(default_factory=list)
    estimate_s: list[float] = field(default_factory=list)
    command_s: list[float] = field(default_factory=list)
    estimate_seq: list[int] = field(default_factory=list)
    command_seq: list[int] = field(default_factory=list)
    overruns: int = 0
    stale: int = 0

    def to_words(self) -> dict[str, str]:
        """Text form for a bag's metadata; the inverse of :meth:`from_words`."""
        lists = {name: ' '.join(map(repr, getattr(self, name))) for name in _LIST_WORDS}
        return {**lists, 'overruns': str(self.overruns), 'stale': str(self.stale)}

    @classmethod
    def from_words(cls, words: Mapping[str, str]) -> FreeRunAccount:
        """Parse the output of :meth:`to_words`.

        Raises:
            KeyError, ValueError: invalid words.
        """
        lists: dict[str, Any] = {
            name: [(float if name.endswith('_s') else int)(word) for word in words[name].split()]
            for name in _LIST_WORDS
        }
        return cls(**lists, overruns=int(words['overruns']), stale=int(words['stale']))

    def figures(self) -> dict[str, float]:
        """Summary figures by name; unknown ones are omitted.

        ``unanswered``: frames without a command; ``late``: answers after the next frame;
        ``perception`` and ``loop`` latency, from the frame to the estimate and to the command, in
        wall-clock and in simulated time (to the frame from which it could take effect); ``factor``:
        achieved real-time factor.
        """
        found = {
            'frames': float(len(self.frame_s)),
            'unanswered': float(sum(math.isnan(time) for time in self.command_s)),
            'late': float(sum(
                seen > seq for seens in (self.estimate_seq, self.command_seq)
                for seq, seen in enumerate(seens)
            )),
            'stale': float(self.stale), 'overruns': float(self.overruns),
        }
        spent = self.frame_s[-1] if self.frame_s else 0.0
        if spent > 0:
            found['factor'] = (len(self.frame_s) - 1) * _STEP_S / spent
        for name, times, seens in (
            ('perception', self.estimate_s, self.estimate_seq),
            ('loop', self.command_s, self.command_seq),
        ):
            wall = [t - f for t, f in zip(times, self.frame_s, strict=True) if not math.isnan(t)]
            steps = [(seen - seq + 1) * _STEP_S for seq, seen in enumerate(seens) if seen >= 0]
            found |= _spread(f'{name}_wall', wall) | _spread(f'{name}_simulated', steps)
        return found


def _spread(name: str, values: Sequence[float]) -> dict[str, float]:
    """Median, 95 % quantile (nearest rank) and maximum of latencies [s]."""
    if not values:
        return {}
    ordered = sorted(values)
    return {
        f'{name}_median_s': statistics.median(ordered),
        f'{name}_p95_s': ordered[math.ceil(0.95 * len(ordered)) - 1],
        f'{name}_max_s': ordered[-1],
    }


def free_run_line(free: Mapping[str, float]) -> str:
    """One-line summary of a free run from its :meth:`FreeRunAccount.figures`."""
    words = [f'{free["unanswered"]:.0f} of {free["frames"]:.0f} frames unanswered']
    if 'loop_wall_median_s' in free:
        words.append(
            f'loop at most {free["loop_wall_max_s"]:.3f} s'
        )
    if free['overruns']:
        words.append(f'{free["overruns"]:.0f} frames late')
    return ', '.join(words)


class Pace:
    """Wall-clock schedule of frames.

    Args:
        factor: real-time factor (simulated per wall-clock seconds); 0: as fast as possible.
    """

    def __init__(self, factor: float) -> None:
        self.step_s = _STEP_S / factor if factor else 0.0
        self._due_s = 0.0

    def begin(self, now_s: float) -> None:
        """Note the publication of the first frame."""
        self._due_s = now_s + self.step_s

    def due(self, now_s: float) -> bool:
        """Whether the next frame is due."""
        return now_s >= self._due_s

    def out(self, now_s: float) -> bool:
        """Note the publication of the next frame; True if it is late.

        A delay of a whole step or more is not caught up, because frames would then be too fast.
        """
        late_s = now_s - self._due_s
        self._due_s = now_s + self.step_s if late_s >= self.step_s else self._due_s + self.step_s
        return bool(self.step_s) and late_s > _LATE_SHARE * self.step_s


class FreeRun(Lockstep):
    """Bookkeeping of one free run; see :class:`Lockstep` for the common interface.

    Attributes:
        account: timing record of the run.
        newest: newest frame with a command; -1 for none.
        settled: frames up to this one get no more answers.
        closed: whether the time of the last frame is over.
    """

    def __init__(
        self, *, participants: Sequence[str], chain: Sequence[str], followers: Sequence[str],
        last_seq: int, factor: float,
    ) -> None:
        """See :class:`Lockstep`; ``factor``: see :class:`Pace`."""
        super().__init__(
            participants=participants, chain=chain, followers=followers, last_seq=last_seq,
        )
        self.pace = Pace(factor)
        self.account = FreeRunAccount()
        self.newest = self.settled = -1
        self.closed = False
        self._arrived = dict.fromkeys(self._progress, -1)
        self._settle_to = self._next_settle_to = -1
        self._begun_s = 0.0
        self._heard_s: dict[str, float] = {}

    def begin(self, seq: int, now_s: float = 0.0) -> None:
        """Note a new frame; the newest command applies from it on."""
        account = self.account
        if seq == 0:
            self._begun_s = now_s
            self.pace.begin(now_s)
            self._heard_s = dict.fromkeys([*self._chain, *self._progress], now_s)
        else:
            account.overruns += self.pace.out(now_s)
        super().begin(seq)
        account.applied.append(self.newest)
        account.frame_s.append(now_s - self._begun_s)
        for times in (account.estimate_s, account.command_s):
            times.append(math.nan)
        for seens in (account.estimate_seq, account.command_seq):
            seens.append(-1)

    def answer(self, node: str, seq: int, now_s: float = 0.0) -> bool:
        """Note the answer of a chain node; False for a repeated or stale one."""
        self._heard_s[node] = now_s
        account = self.account
        first = node == self._chain[0]
        times, seens = (account.estimate_s, account.estimate_seq) if first else (
            account.command_s, account.command_seq)
        if seens[seq] >= 0:
            return False
        commanded = account.command_seq[seq] >= 0
        if (seq <= self.settled and not (first and commanded)) or (
            not first and seq <= self.newest
        ):
            account.stale += 1
            return False
        times[seq], seens[seq] = now_s - self._begun_s, self.seq
        if first:
            return True
        self.newest = seq
        return True

    def progress(self, node: str, seq: int, arrived: int = -1, now_s: float = 0.0) -> None:
        """Note a follower's progress: the last frame processed and the last one received."""
        super().progress(node, seq)
        self._heard_s[node] = now_s
        if node in self._arrived:
            self._arrived[node] = max(self._arrived[node], arrived)

    @property
    def may_advance(self) -> bool:
        """Always False: in a free run, answers do not advance time."""
        return False

    @property
    def room(self) -> bool:
        """Whether the followers' queues can take another frame."""
        return all(arrived > self.seq - WINDOW for arrived in self._arrived.values())

    def settle(self) -> tuple[list[int], list[int]]:
        """Settle frames; return those without an estimate and those without a command.

        Call once per step. An estimate may arrive after the command for a newer frame, so it has
        time until the next call.
        """
        last = min(self._settle_to, self.settled + _AT_ONCE, self._finished + _UNFINISHED)
        fresh = range(self.settled + 1, last + 1)
        self.settled = max(self.settled, last)
        self._settle_to = self._next_settle_to
        self._next_settle_to = self.last_seq if self.closed else self.newest
        account = self.account
        # A command implies that there was an estimate.
        return (
            [seq for seq in fresh if account.estimate_seq[seq] < 0 > account.command_seq[seq]],
            [seq for seq in fresh if account.command_seq[seq] < 0],
        )

    @property
    def _finished(self) -> int:
        return min(self._progress.values(), default=self.last_seq)

    def missing(self) -> list[str]:
        """Names of awaited nodes; only before the first frame and at the end.

        During the run no node is awaited; see :meth:`silent`.
        """
        if self._not_ready:
            return sorted(self._not_ready)
        if not self.closed:
            return []
        return [node for node, seq in self._progress.items() if seq < self.last_seq]

    @property
    def complete(self) -> bool:
        """Whether the time of the last frame is over and every follower has processed it."""
        return self.closed and self.settled == self.last_seq and not self.missing()

    def silent(self, now_s: float, limit_s: float) -> str:
        """Node that has been silent for too long, or ''; of several, the one silent the longest.

        That is the cause: the others, and the simulator, wait for it.
        """
        limit_s = max(limit_s, 3 * self.pace.step_s)
        awaited = [*([] if self.closed else self._chain), *self._progress]
        silent = [name for name in awaited if now_s - self._heard_s[name] > limit_s]
        return min(silent, key=self._heard_s.__getitem__, default='')
