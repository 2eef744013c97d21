"""Chaos test: inject faults into small commands that run scenes, and check what is left.

Each trial starts a command, injects a fault at a moment drawn from the seed (kill, stop, full
disk, moved folder, damaged file), starts it again, up to three times, and lets it end. What it has
recorded must equal what an undisturbed one has. Meanwhile no row may be lost, duplicated or
changed, and no command may hang, leave a process behind, end in a traceback or return an unexpected
exit code.
"""

from __future__ import annotations

import contextlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from common import count, leave, make_table, options, page_console, positive

import psutil
from processes import VERDICTS

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, InfraError, InfraKind, UsageError
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.processes.child import ChildProcess
from taxinet_ros.trials.past_runs.trials import TRIAL
from taxinet_ros.trials.record.facts import ROW
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import CSV_NAME, PARQUET_NAME, read_table

HANG_S = 900.0
"""Time after which a command counts as hung [s], even on a busy machine: most take seconds."""

_LEAVE_S = 60.0
"""Time that child processes may take to end after their command [s]."""

_SITTINGS = 3
"""Maximum number of disturbed sittings in a trial; the one after them is undisturbed."""

_MARK = 'TAXINET_CHAOS'
_HISTORY = ('retries', 'stack', *WALL_CLOCK_COLUMNS)
"""Columns that legitimately differ in a disturbed campaign: its history and its machine."""

_EXPERIMENT = """\
program: nominal
runs: 3
seed: 4
sampler: halton
perception: truth
set: {duration_s: 1}
arms:
  shadows: {}
  no_shadows: {set: {shadows: off}}
"""

@dataclass(frozen=True, kw_only=True)
class Subject:
    """A command that is disturbed.

    Attributes:
        words: the command, without ``--out``.
        runs: least number of runs in each of its folders.
        folders: folders of its records, relative to its output folder.
        resumable: whether it goes on where it was.
        resume: what is added to go on.
        of: words of a campaign that has to be there before, beside the output folder as ``of``.
        kind: kind of the entries of its record that are compared.
        codes: exit codes with which it may end undisturbed.
    """

    words: tuple[str, ...]
    runs: int
    folders: tuple[str, ...] = ('',)
    resumable: bool = True
    resume: tuple[str, ...] = ('--resume',)
    of: tuple[str, ...] = ()
    kind: str = ROW
    codes: tuple[int, ...] = VERDICTS


_RUN = ('--perception', 'truth', '--images', 'none', '--set', 'duration_s=1', '--seed', '4',
        '--spec', 'tight=always(abs(cte) <= 0.3)')

_FAILING = (
    'run', 's_falsif', '--runs', '4', '--perception', 'original', '--engine', 'loop', '--set',
    'duration_s=3', '--spec', 'tight=always(abs(cte) <= 0.3)', '--images', 'none',
)

SUBJECTS: Mapping[str, Subject] = {
    'falsify': Subject(words=(
        'falsify', 'nominal', '--runs', '8', '--workers', '2', '--sampler', 'ce',
        '--sampler-option', 'every=1', *_RUN,
    ), runs=8),
    'falsify, one worker': Subject(words=('falsify', 'nominal', '--runs', '12', *_RUN), runs=12),
    'experiment': Subject(
        words=('experiment', '../experiment.yaml', '--workers', '2'), runs=3,
        folders=('shadows', 'no_shadows'),
    ),
    'run': Subject(words=('run', 'nominal', '--runs', '5', '--processes', *_RUN), runs=5,
                   resumable=False),
    'shrink': Subject(
        words=('shrink', '../of/s_falsif-s0-00000', '--engine', 'loop'), runs=8,
        of=_FAILING,
    ),
    'localize': Subject(
        words=('localize', '../of', '--workers', '2'), runs=8, resume=(), of=_FAILING, kind=TRIAL,
    ),
    'compare': Subject(
        words=('compare', 'original', 'taxinet', '../of', '--workers', '2'), runs=8, resume=(),
        of=_FAILING, kind=TRIAL,
    ),
    'bisect': Subject(
        words=('bisect', 'original', 'generic', 'taxinet', '--scene', '../of', '--every'), runs=8,
        resume=(), of=_FAILING, kind=TRIAL,
    ),
    'tune': Subject(
        words=('tune', 'nominal', '--perception', 'truth', '--candidates', '3', '--scenes', '3',
               '--unseen', '3'),
        runs=6, resume=(), kind=TRIAL, codes=(0, ExitCode.INCOMPLETE),
    ),
    'assure judge': Subject(
        words=('assure', 'judge', 'nominal', '--perception', 'original', '--monitor', 'original',
               '--fallback', 'stop', '--runs', '4'),
        runs=4, resume=(), kind=TRIAL,
    ),
}


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A fault injected into a running campaign.

    Attributes:
        act: injects it into the processes and the folder.
        codes: exit codes that the campaign may end with because of it; it may always end as if
            undisturbed.
        afterwards: repairs what a user would repair, once the campaign has ended.
        too_early: messages which, with exit code 2, mean that the fault came before the campaign
            had opened its folder.
    """

    act: Callable[[_Sitting], None]
    codes: frozenset[int] = frozenset()
    afterwards: Callable[[_Sitting], None] = lambda sitting: None
    too_early: tuple[str, ...] = ()


@dataclass
class Found:
    """Results of all trials.

    Attributes:
        trials, sittings: their numbers.
        rows: number of rows compared with those of undisturbed campaigns.
        ends: how often each fault led to each exit code.
        broken: violations: trial, kind and description.
    """

    seed: int
    trials: int = 0
    sittings: int = 0
    rows: int = 0
    ends: dict[str, Counter[str]] = field(default_factory=dict)
    broken: list[tuple[int, str, str]] = field(default_factory=list)

    def report(self) -> dict[str, Any]:
        """Plain values, ready for JSON."""
        return {
            'seed': self.seed, 'trials': self.trials, 'sittings': self.sittings,
            'rows_compared': self.rows,
            'faults': {name: dict(ends) for name, ends in sorted(self.ends.items())},
            'found': dict(Counter(kind for _, kind, _ in self.broken)),
            'broken': [
                {'trial': trial, 'kind': kind, 'words': words} for trial, kind, words in self.broken
            ],
        }


class Chaos:
    """Trials, each in its own folder, which is kept on a violation."""

    def __init__(self, folder: Path, command: Sequence[str], seed: int) -> None:
        """Prepare the trials; nothing is started yet.

        Args:
            folder: an empty folder.
            command: command that starts ``taxinet``.
            seed: seed of all random draws.
        """
        self.found = Found(seed=seed)
        self._folder = folder
        self._command = tuple(command)
        self._undisturbed: dict[str, tuple[int, Rows]] = {}
        (folder / 'experiment.yaml').write_text(_EXPERIMENT)

    def trial(self, number: int) -> None:
        """Run one trial; its draws depend only on the seed and its number.

        Raises:
            InfraError: an undisturbed campaign does not end as it should.
        """
        draw = random.Random(f'{self.found.seed} {number}')
        name = draw.choice(list(SUBJECTS))
        expected = self._whole(name)
        place = self._folder / f'trial-{number}'
        place.mkdir()
        trial = _Trial(self, SUBJECTS[name], place, number, draw, expected)
        trial.go()
        self.found.trials += 1
        if all(broken[0] != number for broken in self.found.broken):
            shutil.rmtree(place)

    def sit(self, words: Sequence[str], place: Path) -> _Sitting:
        """Start a command."""
        self.found.sittings += 1
        return _Sitting([*self._command, *words], place)

    def _prepare(self, subject: Subject) -> None:
        """Make the campaign that a command is about, once."""
        if subject.of and not (self._folder / 'of').is_dir():
            with self.sit([*subject.of, '--out', 'of'], self._folder) as sitting:
                if (code := sitting.ended()) not in VERDICTS:
                    raise InfraError(
                        InfraKind.DIED, 'of', -1, f'ended with {code}: {sitting.last_line}')

    def _whole(self, name: str) -> tuple[int, Rows]:
        """Exit code and rows of an undisturbed campaign."""
        if name not in self._undisturbed:
            place = self._folder / f'whole-{len(self._undisturbed)}'
            place.mkdir()
            subject = SUBJECTS[name]
            self._prepare(subject)
            with self.sit([*subject.words, '--out', 'c'], place) as sitting:
                code = sitting.ended()
            rows = _rows(subject, sitting.out)
            if code not in subject.codes or len(rows) < subject.runs * len(subject.folders):
                raise InfraError(
                    InfraKind.DIED, name, -1, f'ended with {code}: {sitting.last_line}'
                )
            self._undisturbed[name] = (code or 0, rows)
        return self._undisturbed[name]


Rows = dict[tuple[str, str], dict[str, Any]]
"""Values of the results by folder and key."""


class _Sitting:
    """A running command and its descendants; a context manager that ends all of them."""

    def __init__(self, command: Sequence[str], place: Path) -> None:
        self.place, self.out = place, place / 'c'
        self._mark = f'{os.getpid()}-{place}-{time.monotonic_ns()}'
        self._printed = place / 'printed.txt'
        self.began = self._printed.stat().st_size if self._printed.exists() else 0
        self._child = ChildProcess(
            'taxinet', command, log=self._printed, folder=place,
            environment={**os.environ, _MARK: self._mark, 'COLUMNS': '200'},
        )
        self.process = self._child.process

    def __enter__(self) -> _Sitting:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self.left():
            _tell(process, signal.SIGKILL)
        self._child.wait()

    @property
    def printed(self) -> str:
        """Its output so far."""
        return self._printed.read_bytes()[self.began:].decode(errors='replace')

    @property
    def last_line(self) -> str:
        """The last line of its output."""
        return next(iter(reversed(self.printed.strip().splitlines())), '')

    def left(self, *words: str) -> list[psutil.Process]:
        """Its processes that still run, limited to commands that contain one of ``words``."""
        found = []
        for process in psutil.process_iter():
            try:
                mine = process.environ().get(_MARK) == self._mark
                line = ' '.join(process.cmdline()) if mine else ''
                alive = mine and process.status() != psutil.STATUS_ZOMBIE
            except psutil.Error:
                continue
            if alive and (not words or any(word in line for word in words)):
                found.append(process)
        return found

    def ended(self) -> int | None:
        """Its exit code; None if it hangs."""
        return self._child.wait(HANG_S)

    def orphans(self) -> list[str]:
        """Processes still running some time after its end."""
        deadline = time.monotonic() + _LEAVE_S
        while (left := self.left()) and time.monotonic() < deadline:
            time.sleep(0.1)
        return [str(process) for process in left]

    def await_results(self, number: int) -> bool:
        """Wait for ``number`` results; False if it ended before."""
        deadline = time.monotonic() + HANG_S
        while self.process.poll() is None and time.monotonic() < deadline:
            told = sum(_results(path) for path in self.out.glob(f'**/{RECORD_NAME}'))
            if told >= number:
                return True
            time.sleep(0.02)
        return False


class _Trial:
    """One campaign, from its first sitting to the comparison."""

    def __init__(
        self, chaos: Chaos, subject: Subject, place: Path, number: int, draw: random.Random,
        expected: tuple[int, Rows],
    ) -> None:
        self._chaos, self._found = chaos, chaos.found
        self._subject, self._place, self._number, self._draw = subject, place, number, draw
        self._code, self._whole = expected
        self._out = place / 'c'
        self._judged: Rows = {}
        self._kept: dict[Path, bytes] = {}

    def go(self) -> None:
        """Disturb the campaign and let it end."""
        faults = RESUMED if self._subject.resumable else NOT_RESUMED
        sittings = self._draw.randint(1, _SITTINGS) if self._subject.resumable else 1
        for _ in range(sittings):
            name = self._draw.choice(faults)
            code = self._disturbed(name, FAULTS[name])
            if code is None or not self._subject.resumable:
                return
            if self._draw.random() < 0.5:
                self._damage()
        self._undisturbed_end()

    def _words(self) -> list[str]:
        begun = any(self._out.iterdir()) if self._out.is_dir() else False
        return [*self._subject.words, '--out', 'c', *(self._subject.resume if begun else ())]

    def _disturbed(self, name: str, fault: Fault) -> int | None:
        """Run one sitting with a fault and return its exit code, None if it hangs."""
        before = self._told()
        moment = before + self._draw.randrange(max(len(self._whole) - before, 1))
        delay_s = self._draw.uniform(0, 0.4)
        with self._chaos.sit(self._words(), self._place) as sitting:
            in_time = sitting.await_results(moment)
            if in_time:
                time.sleep(delay_s)
                fault.act(sitting)
            code = sitting.ended()
            told = sitting.last_line
            early = code == ExitCode.USAGE and any(words in told for words in fault.too_early)
            self._check(name, sitting, code, {*fault.codes, self._code, 0, 1, *([2] * early)})
        fault.afterwards(sitting)
        self._note(name, 'too early' if early else str(code) if in_time else 'too late')
        if code == ExitCode.USAGE and self._kept and not early:  # refused: names the damage
            return self._fixed(name, sitting)
        if self._kept and code not in self._subject.codes and self._told() == before:
            return code  # may have ended before reading the damaged file: the next sitting reads it
        self._kept.clear()  # damage that was not refused must leave the rows unchanged
        self._check_rows(name, code)
        return code

    def _told(self) -> int:
        return sum(_results(path) for path in self._out.glob(f'**/{RECORD_NAME}'))

    def _undisturbed_end(self) -> None:
        with self._chaos.sit(self._words(), self._place) as sitting:
            code = sitting.ended()
            self._check('the last sitting', sitting, code, {self._code})
        if code == ExitCode.USAGE and self._kept:
            self._fixed('the last sitting', sitting)
            self._undisturbed_end()
            return
        self._check_rows('the last sitting', code)
        if code is not None:
            self._compare()

    # Checks ------------------------------------------------------------------------------------

    def _note(self, name: str, end: str) -> None:
        self._found.ends.setdefault(name, Counter())[end] += 1

    def _broke(self, kind: str, words: str) -> None:
        self._found.broken.append((self._number, kind, words))

    def _check(self, name: str, sitting: _Sitting, code: int | None, allowed: set[int]) -> None:
        """Check the conditions that hold for every command, however it ends."""
        if code is None:
            self._broke('hang', f'{name}: still there after {HANG_S:g} s')
            return
        if self._kept:
            allowed = {*allowed, 2}
        if code not in allowed:
            self._broke('exit code', f'{name}: {code}: {sitting.last_line}')
        if left := sitting.orphans():
            self._broke('orphan', f'{name}: {left[0]}')
        for word in ('Traceback (most recent call last)', 'a defect of taxinet'):
            if word in sitting.printed:
                self._broke('traceback', f'{name}: {sitting.last_line}')

    def _check_rows(self, name: str, code: int | None) -> None:
        """Check that no judged row is lost, changed or duplicated; all exist after a verdict."""
        rows = self._rows(name)
        for key, row in self._judged.items():
            if key not in rows or not _judged(rows[key]):
                self._broke('rows lost', f'{name}: run {key} is gone')
            elif changed := _changed(row, rows[key]):
                self._broke('rows changed', f'{name}: run {key}: {changed}')
        self._judged = {key: row for key, row in rows.items() if _judged(row)}
        for key, row in self._judged.items():
            if changed := _changed(self._whole[key], row):
                self._broke('rows changed', f'{name}: run {key} of the undisturbed one: {changed}')
        if code in self._subject.codes:
            self._check_verdict(name, code, rows)

    def _rows(self, name: str) -> Rows:
        """Current rows; none if a record cannot be read, which is recorded as a violation."""
        try:
            return _rows(self._subject, self._out)
        except UsageError as error:
            self._broke('rows lost', f'{name}: {error}')
            return {}

    def _check_verdict(self, name: str, code: int, rows: Rows) -> None:
        """Check that the exit code agrees with the verdicts of all runs."""
        if len(rows) < len(self._whole):
            self._broke('rows lost', f'{name}: {len(rows)} rows with exit code {code}')
        if any(row.get('outcome') == Outcome.INFRA_ERROR for row in rows.values()):
            self._broke('exit code', f'{name}: {code} with a broken run')

    def _compare(self) -> None:
        """Check that the final record and table equal those of the undisturbed campaign."""
        rows = self._rows('the end')
        self._found.rows += len(rows)
        if rows.keys() != self._whole.keys():
            self._broke('rows lost', f'{len(rows)} of {len(self._whole)} rows in the end')
        for folder in self._subject.folders if self._subject.kind == ROW else ():
            try:
                table = read_table(self._out / folder)
            except UsageError as error:
                self._broke('rows lost', f'the table: {error}')
                continue
            told = {int(index): outcome for index, outcome in
                    zip(table['index'], table['outcome'], strict=True)}
            if told != {
                int(key): row['outcome'] for (place, key), row in rows.items() if place == folder
            }:
                self._broke('rows changed', f'the table of {self._out / folder} is another')

    # Damage ------------------------------------------------------------------------------------

    def _damage(self) -> None:
        """Damage a file between two sittings, which must not go unnoticed."""
        name = self._draw.choice(list(DAMAGES))
        files = sorted(path for pattern in DAMAGES[name] for path in self._out.glob(pattern))
        files = [path for path in files if path.stat().st_size]
        if not files:
            return
        path = self._draw.choice(files)
        data = bytearray(path.read_bytes())
        self._kept.setdefault(path, bytes(data))
        if name == 'record cut':
            del data[self._draw.randrange(4096, len(data)):]
        else:
            data[self._draw.randrange(len(data))] ^= 1 << self._draw.randrange(8)
        if path.name == RECORD_NAME:
            self._judged.clear()  # what is lost is made again
        path.write_bytes(bytes(data))
        noticed = ''
        if name == 'bag bit':
            noticed = self._doctor(path)
        self._note(name, noticed or 'done')

    def _doctor(self, path: Path) -> str:
        """Run ``taxinet doctor`` on a damaged bag."""
        with self._chaos.sit(['doctor', str(path)], self._place) as sitting:
            code = sitting.ended()
            self._check('doctor', sitting, code, {ExitCode.USAGE, ExitCode.INCOMPLETE})
            if code == ExitCode.OK:
                self._broke('in silence', f'doctor calls {path.name} sound')
        del self._kept[path]  # no campaign reads it again
        return f'doctor {code}'

    def _fixed(self, name: str, sitting: _Sitting) -> int:
        """Check that the refusal names the damaged file, then restore the file."""
        if not any(path.name in sitting.last_line for path in self._kept):
            self._broke('exit code', f'{name}: 2: {sitting.last_line}')
        for path, data in self._kept.items():
            path.write_bytes(data)
        self._kept.clear()
        return ExitCode.USAGE


def _results(record: Path) -> int:
    """Number of results in a record."""
    try:
        return sum(len(read_record(record).get(kind, ())) for kind in (ROW, TRIAL))
    except (OSError, UsageError):
        return 0


def _rows(subject: Subject, out: Path) -> Rows:
    """All results in the records."""
    return {
        (folder, key): values for folder in subject.folders
        if (out / folder / RECORD_NAME).is_file()
        for key, values in read_record(out / folder / RECORD_NAME).get(subject.kind, {}).items()
    }


def _judged(values: Mapping[str, Any]) -> bool:
    """Whether a result has a verdict; those of commands without bags say it in other words."""
    if 'outcome' in values:
        return Outcome(values['outcome']).judged
    return values.get('passed', True) is not None


def _changed(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Values in which two results differ although they must be equal."""
    return ', '.join(
        f'{key} {before.get(key)} is {after.get(key)}' for key in {**before, **after}
        if key not in _HISTORY and before.get(key) != after.get(key)
    )


# Faults ----------------------------------------------------------------------------------------

_WORKER, _SCENIC, _NODE = 'nodes.worker', 'scenic_child', 'taxinet_ros.nodes.'


def _tell(process: psutil.Process, number: int) -> None:
    with contextlib.suppress(psutil.Error):
        process.send_signal(number)


def _signal(*numbers: int, pause_s: float = 0.1) -> Callable[[_Sitting], None]:
    """Send signals to the campaign's main process, one after the other."""
    def act(sitting: _Sitting) -> None:
        for number in numbers:
            if sitting.process.poll() is None:
                sitting.process.send_signal(number)
            time.sleep(pause_s)

    return act


def _to_one(word: str, *numbers: int, pause_s: float = 0.0) -> Callable[[_Sitting], None]:
    """Send signals to one of the processes of a kind."""
    def act(sitting: _Sitting) -> None:
        for process in sitting.left(word)[:1]:
            for number in numbers:
                _tell(process, number)
                time.sleep(pause_s)

    return act


def _no_room(sitting: _Sitting) -> None:
    """Keep all files from growing, as on a full disk."""
    for process in sitting.left():
        try:
            process.rlimit(resource.RLIMIT_FSIZE, (4096, resource.RLIM_INFINITY))
        except psutil.Error:
            continue


def _move(sitting: _Sitting) -> None:
    if sitting.out.is_dir():
        sitting.out.rename(sitting.place / 'elsewhere')


def _replace(sitting: _Sitting) -> None:
    if sitting.out.is_dir():
        _move(sitting)
        sitting.out.mkdir()


def _move_back(sitting: _Sitting) -> None:
    moved = sitting.place / 'elsewhere'
    if not moved.is_dir():
        return
    anew = sitting.process.returncode in VERDICTS and any(sitting.out.glob(f'**/{RECORD_NAME}'))
    if anew:  # it was moved before the command had opened it
        shutil.rmtree(moved)
        return
    if sitting.out.is_dir():
        shutil.rmtree(sitting.out)
    moved.rename(sitting.out)


def _copy_over(sitting: _Sitting) -> None:
    """Replace a record by another file with the same bytes."""
    for record in sorted(sitting.out.glob(f'**/{RECORD_NAME}'))[-1:]:
        shutil.copy(record, sitting.place / 'record')
        (sitting.place / 'record').rename(record)


_BROKEN = frozenset({ExitCode.INFRA})
_NOTHING_THERE = ('no such file, so there is nothing to resume', 'c: holds no arm of experiment')


def _ends(number: int) -> frozenset[int]:
    """Exit codes of a command that a signal ends: the second before Python handles signals."""
    return frozenset({128 + number, -number})


FAULTS: Mapping[str, Fault] = {
    'campaign killed': Fault(
        act=_signal(signal.SIGKILL), codes=frozenset({-signal.SIGKILL})),
    'campaign terminated': Fault(act=_signal(signal.SIGTERM), codes=_ends(signal.SIGTERM)),
    'Ctrl-C': Fault(act=_signal(signal.SIGINT), codes=_ends(signal.SIGINT)),
    'Ctrl-C twice': Fault(
        act=_signal(signal.SIGINT, signal.SIGINT), codes=_ends(signal.SIGINT)),
    'campaign stopped': Fault(act=_signal(signal.SIGSTOP, signal.SIGCONT, pause_s=1.0)),
    'worker killed': Fault(act=_to_one(_WORKER, signal.SIGKILL)),
    'worker terminated': Fault(act=_to_one(_WORKER, signal.SIGTERM)),
    'worker stopped': Fault(act=_to_one(_WORKER, signal.SIGSTOP, signal.SIGCONT, pause_s=1.0)),
    'Scenic killed': Fault(act=_to_one(_SCENIC, signal.SIGKILL), codes=_BROKEN),
    'node killed': Fault(act=_to_one(_NODE, signal.SIGKILL), codes=_BROKEN),
    'node terminated': Fault(act=_to_one(_NODE, signal.SIGTERM), codes=_BROKEN),
    'node stopped': Fault(act=_to_one(_NODE, signal.SIGSTOP, signal.SIGCONT, pause_s=1.0)),
    'no room': Fault(act=_no_room, codes=_BROKEN),
    'folder moved': Fault(
        act=_move, codes=_BROKEN, afterwards=_move_back, too_early=_NOTHING_THERE),
    'folder replaced': Fault(
        act=_replace, codes=_BROKEN, afterwards=_move_back, too_early=_NOTHING_THERE),
    'record replaced': Fault(act=_copy_over, codes=_BROKEN),
}

_OF_ALL = ('campaign killed', 'campaign terminated', 'Ctrl-C', 'Ctrl-C twice', 'campaign stopped',
           'Scenic killed', 'no room', 'folder moved', 'folder replaced', 'record replaced')
RESUMED = (*_OF_ALL, 'worker killed', 'worker terminated', 'worker stopped')
NOT_RESUMED = (*_OF_ALL, 'node killed', 'node terminated', 'node stopped')

DAMAGES: Mapping[str, tuple[str, ...]] = {
    'bag bit': ('**/*.mcap',),
    'table bit': (f'**/{CSV_NAME}', f'**/{PARQUET_NAME}'),
    'record bit': (f'**/{RECORD_NAME}',),
    'record cut': (f'**/{RECORD_NAME}',),
}


def numbers(trials: int | None, minutes: float | None, only: int | None) -> Iterator[int]:
    """Numbers of the trials to run: ``only``, ``trials``, or all that start within ``minutes``."""
    if only is not None:
        yield only
        return
    end_s = time.monotonic() + 60 * (minutes or 0)
    number = 0
    while number < trials if trials is not None else time.monotonic() < end_s:
        yield number
        number += 1


MINUTES = 10.0


def show(found: Found, folder: Path) -> None:
    """Print a table of the faults, and what broke."""
    console, report = page_console(), found.report()
    console.print(
        f'{found.trials} trials, {found.sittings} commands, {found.rows} rows compared with those '
        'of undisturbed campaigns', soft_wrap=True,
    )
    table = make_table(('fault', 'times', 'ended with'), ())
    for name, ends in report['faults'].items():
        words = ', '.join(f'{code}: {times}' for code, times in sorted(ends.items()))
        table.add_row(name, str(sum(ends.values())), words)
    console.print(table)
    if not found.broken:
        console.print('nothing broke')
        return
    words = ', '.join(f'{times} {kind}' for kind, times in report['found'].items())
    console.print(
        f'broke: {words}; to repeat one: python benchmarks/chaos.py --seed {found.seed} --trial '
        f'{found.broken[0][0]}; its remains: {folder}', soft_wrap=True,
    )


def main(words: Sequence[str] | None = None) -> int:
    """Run the trials and print the results.

    Returns:
        Exit code: 0 no failure, 4 some trial failed.
    """
    parser = options(__doc__)
    parser.add_argument('--seed', type=int, default=0, help='seed of all draws')
    amount = parser.add_mutually_exclusive_group()
    amount.add_argument('--minutes', type=positive, metavar='M',
                        help=f'wall time in which trials start (default {MINUTES:g}) [min]')
    amount.add_argument('--trials', type=count, help='number of trials')
    amount.add_argument('--trial', type=int, help='only this one')
    given = parser.parse_args(words)
    if given.trials is None and given.trial is None:
        given.minutes = given.minutes or MINUTES
    folder = Path(tempfile.mkdtemp(prefix='taxinet-chaos-'))
    # The installed command, which blocks signals while Python starts.
    chaos = Chaos(folder, [str(Path(sys.executable).with_name('taxinet'))], given.seed)
    found = chaos.found
    try:
        for number in numbers(given.trials, given.minutes, given.trial):
            before = len(found.broken)
            chaos.trial(number)
            for _, kind, what in found.broken[before:]:
                print(f'trial {number}: {kind}: {what}', file=sys.stderr)
    finally:
        if not found.broken:
            shutil.rmtree(folder)
    print(json.dumps(found.report(), indent=2)) if given.json else show(found, folder)
    return ExitCode.INFRA if found.broken else ExitCode.OK


if __name__ == '__main__':
    leave(main)
