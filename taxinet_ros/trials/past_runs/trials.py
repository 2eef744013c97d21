"""Trials: scenes run once more in the closed loop without ROS, in worker processes, and kept.

A :class:`.Task` is a scene to run, with what drives and the requirements; a :class:`Trial` is its
result. A :class:`TrialRecord` keeps results in ``campaign.db``, so a command that is run again
makes only those that are missing. A run that breaks, crashes or hangs is a trial without a verdict.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import InfraError, InfraKind, UsageError, warn_once
from taxinet_ros.files.record import RECORD_NAME, Record, plain, repair_record, repaired
from taxinet_ros.trials.engine import run_search
from taxinet_ros.trials.loop_worker import loop_worker_command
from taxinet_ros.trials.options import make_out
from taxinet_ros.trials.record.row import path_figures
from taxinet_ros.trials.worker_pool import SILENCE_S, Task, WorkerPool

SETTINGS, SITTING, TRIAL = 'settings', 'sitting', 'trial'
"""Kinds of the entries of a record of trials: settings, machine of each sitting, results."""
_SPARE = 'settings_spare'
"""Kind of a second entry of the settings, without which no trial counts."""
_PATIENCE = 10
"""Number of lost workers in a row after which a command ends."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """Result of one trial.

    Attributes:
        run_id: name of the run that is repeated.
        word: word of the substitution.
        passed: whether all formulas were satisfied; None if the run could not be judged.
        detail: reason why it could not be judged.
        exact: whether its scene was bit-exact, so that it must reproduce the recorded result.
        robustness: robustness of the headline; exact unless the run was stopped early.
        others: the same of the other formulas, by name.
        max_cross_track_m, settle_time_s, left_runway: as of :class:`.RunRow`; None if unknown.
        seen: what the observer of the task saw.
    """

    run_id: str
    word: str
    passed: bool | None
    detail: str = ''
    exact: bool = True
    robustness: RobustnessInterval | None = None
    others: Mapping[str, RobustnessInterval] = field(default_factory=dict)
    max_cross_track_m: float | None = None
    settle_time_s: float | None = None
    left_runway: bool | None = None
    seen: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, task: Task, result: RunResult) -> Self:
        """The trial of a task that has ended."""
        judged = result.outcome.judged
        others = dict(result.robustness)
        headline = others.pop(next(iter(others))) if others else None
        return cls(
            run_id=task.run_id, word=task.word, exact=task.exact,
            passed=result.outcome is Outcome.PASS if judged else None,
            detail='' if judged else f'{result.who}: {result.detail}',
            robustness=headline, others=others, **path_figures(result),
            seen=result.seen,
        )

    @property
    def judged(self) -> bool:
        """Whether it has a verdict."""
        return self.passed is not None

    def about(self, spec: str) -> Self:
        """The trial as judged by one of several formulas alone; the headline if not in others."""
        if self.passed is None or not self.others:
            return self
        known = self.others.get(spec, self.robustness)
        decided = known is not None and known.decided
        return replace(
            self, robustness=known, passed=known.satisfied if known and decided else None,
            detail='' if decided else f'stopped before {spec} was decided',
        )

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of :meth:`from_json`."""
        values = asdict(self)
        if not self.others:
            del values['others']
        values['rho_lower'], values['rho_upper'] = values.pop('robustness') or (None, None)
        if not self.seen:
            del values['seen']
        return values

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Create from the values of :meth:`to_json`.

        Raises:
            KeyError, TypeError: a field is missing or unknown.
        """
        columns = dict(values)
        ends = columns.pop('rho_lower'), columns.pop('rho_upper')
        others = {
            name: RobustnessInterval(*one) for name, one in columns.pop('others', {}).items()
        }
        return cls(
            **columns, robustness=None if None in ends else RobustnessInterval(*ends),
            others=others,
        )


class TrialPool(contextlib.ExitStack):
    """Worker processes that make trials, started when they are needed; a context manager."""

    def __init__(self, workers: int) -> None:
        """``workers``: number of processes; no result depends on it."""
        super().__init__()
        logs = self.enter_context(tempfile.TemporaryDirectory(prefix='taxinet-trials-'))
        self._pool = self.enter_context(
            WorkerPool(loop_worker_command(), workers, Path(logs), SILENCE_S)
        )

    def run(
        self, tasks: Iterable[Task], take: Callable[[Trial], None],
        interrupted: Callable[[], bool] = lambda: False,
    ) -> None:
        """Make trials.

        Args:
            tasks: what to run; read only as fast as workers are free.
            take: called with each trial as it ends.
            interrupted: whether to start no more; those in flight end at their next step.

        Raises:
            UsageError: a system cannot be used.
            InfraError: worker processes end one after the other.
        """
        run_search(_Trials(iter(tasks), take, interrupted), self._pool)


class _Trials:
    """Tasks in their order, as what a pool of workers runs."""

    def __init__(
        self, tasks: Iterator[Task], take: Callable[[Trial], None],
        interrupted: Callable[[], bool],
    ) -> None:
        self._tasks, self._take, self._interrupted = tasks, take, interrupted
        self._fingerprints: dict[str, str] = {}
        self._lost = 0

    @property
    def interrupted(self) -> bool:
        return self._interrupted()

    def next(self) -> RunRequest | None:
        return None if self.interrupted else next(self._tasks, None)

    def take(self, request: RunRequest, result: RunResult) -> None:
        assert isinstance(request, Task)
        if result.outcome is Outcome.INTERRUPTED:
            return
        word, found = request.system.perception, result.fingerprint
        # A worker that replaces a lost one reads the file again.
        if found and self._fingerprints.setdefault(word, found) != found:
            raise UsageError(f'perception {word} has changed since this began; put it back')
        self._take(Trial.of(request, result))
        self._lost = self._lost + 1 if result.who == 'worker' else 0
        if self._lost == _PATIENCE:
            raise InfraError(
                InfraKind(result.kind), f'{_PATIENCE} workers in a row', result.last_seq,
                result.detail,
            )


def check_trials_folder(out: Path) -> None:
    """Check that a folder can have trials: it is new or empty, or has a record.

    Raises:
        UsageError: it contains something else, such as trials of an earlier version.
    """
    if out.is_dir() and not (out / RECORD_NAME).exists() and (names := sorted(out.iterdir())):
        raise UsageError(
            f'out {out}: contains something else ({names[0].name}); choose another folder'
        )


class TrialRecord:
    """Trials kept in a folder, for one command at a time. A context manager.

    Attributes:
        done: trials by key: the judged ones of earlier sittings, and all of this one.
    """

    def __init__(self, out: Path, settings: Mapping[str, Any], other: str) -> None:
        """Open or create the record in ``out``.

        What a damaged record has lost is made again.

        Args:
            out: the folder.
            settings: plain values of everything that results depend on besides their keys.
            other: what a folder with other settings has, for the error message.

        Raises:
            UsageError: the folder cannot be used, contains something else, or trials with other
                settings; or another command uses it.
        """
        check_trials_folder(out)
        make_out(out)
        path = out / RECORD_NAME
        try:
            damaged = repair_record(path)
            self._record = Record(path)
        except OSError as error:
            raise UsageError(f'out {out}: cannot be used: {error.strerror}') from error
        if damaged:
            warn_once(damaged)
        self._pool: TrialPool | None = None
        try:
            self._begin(f'out {out}: {other}; choose another folder', settings)
            self.done = self._earlier()
        except BaseException:
            self._record.close()
            raise

    def _begin(self, refusal: str, settings: Mapping[str, Any]) -> None:
        entries, made_on = self._record.entries, dict(provenance())
        recorded = entries.get(SETTINGS, {}).get('', entries.get(_SPARE, {}).get(''))
        if recorded is None:  # lost by damage: nothing says of what the trials are
            self._record.remove(TRIAL)
            entries.pop(TRIAL, None)
        elif recorded != plain(settings):
            raise UsageError(refusal)
        sittings = entries.get(SITTING, {})
        last = max(sittings, default='0')
        if not sittings or sittings[last] != made_on or recorded is None:
            self._record.put_all([
                (SETTINGS, '', settings), (SITTING, f'{int(last) + 1:04}', made_on),
                (_SPARE, '', settings),
            ])
        repaired(self._record)

    def _earlier(self) -> dict[str, Trial]:
        found = {}
        for key, values in self._record.entries.get(TRIAL, {}).items():
            try:
                trial = Trial.from_json(values)
            except (LookupError, TypeError, ValueError) as error:
                raise UsageError(
                    f'{self._record.path}: trial {key!r} is of another version ({error}); choose '
                    'another folder'
                ) from error
            if trial.judged:
                found[key] = trial
        return found

    def make(
        self, wanted: Mapping[str, Callable[[], Task]], workers: int,
        on_trial: Callable[[], None] = lambda: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> dict[str, Trial]:
        """Make those of the trials that are missing.

        Args:
            wanted: by key what makes the task, called when a worker is free.
            workers: number of processes; no result depends on it.
            on_trial: called after each trial, when it is on the disk.
            interrupted: whether to start no more.

        Returns:
            The trials by key; after an interrupt some are missing.

        Raises:
            UsageError: a system cannot be used.
            InfraError: worker processes end one after the other.
            OSError: a trial cannot be written, as on a full disk.
            RecordError: the folder was moved, deleted or replaced.
        """
        missing = {key: make for key, make in wanted.items() if key not in self.done}
        keys: dict[tuple[str, str], str] = {}

        def tasks() -> Iterator[Task]:
            for key, make in missing.items():
                task = make()
                assert (task.run_id, task.word) not in keys, 'two trials of one name'
                keys[task.run_id, task.word] = key
                yield task

        def keep(trial: Trial) -> None:
            self.keep(keys[trial.run_id, trial.word], trial)
            on_trial()

        if missing:
            if self._pool is None:
                self._pool = TrialPool(workers)
            self._pool.run(tasks(), keep, interrupted)
        return {key: self.done[key] for key in wanted if key in self.done}

    def keep(self, key: str, trial: Trial) -> None:
        """Write a trial to the disk. Raises as :meth:`make`."""
        self._record.put(TRIAL, key, trial.to_json())
        self.done[key] = trial

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with contextlib.closing(self._record):
            if self._pool is not None:
                self._pool.close()
            if kind is None:
                self._record.check_in_place()
