"""Seeded faults: which of small faults, planted in the code one at a time, the tests detect.

``reach`` finds the tests that reach each fault, ``run`` plants each and runs these tests until one
fails, ``again`` plants each and runs the test that caught it before, ``table`` counts. They work in
a checkout whose taxinet_ros is as committed, change it, and put it back. ``seeded_faults.jsonl``
holds the faults, drawn by ``draw_faults.py``, and what caught them; the tests that reach them and
the log are in ``build/seeded_faults``.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import dataclasses
import itertools
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from common import leave, make_table, page_console

from taxinet_ros.errors import ExitCode, UsageError

HERE = Path(__file__).resolve().parent
FAULTS = HERE / 'seeded_faults.jsonl'
PACKAGE = 'taxinet_ros'
ROOMS: Mapping[str, Sequence[str]] = {
    'core': ('core',), 'campaign': ('trials', 'scenes', 'samplers', 'files', 'api'),
    'bag': ('bag',), 'nodes': ('nodes',), 'analysis': ('analysis',),
}
"""Folders of the package whose functions are changed."""

SUITES = {'fast': 'not nightly', 'nightly': 'nightly', 'before': ''}
"""Tests by their marks; those before are all of a checkout of an earlier commit."""
WORK = Path('build/seeded_faults')

_QUICK_S, _QUICKEST, _FIRST_FILES = 10.0, 3, 5
"""Tried first: tests of about this time [s], so many of a file, of so many files."""
_TEST_S = 600
"""Time limit of one test [s]."""
_MEMORY_BYTES = 4 << 30
"""What a process may fill: a fault can have one grow without end."""
_REACHED = 'reached.py'
_PROBE = """\
import os
import time

_seen = set()
_environment, _link, _pid, _time = os.environ, os.symlink, os.getpid, time.time


def hit(number):
    test = _environment.get('PYTEST_CURRENT_TEST')
    if (number, test) not in _seen:
        _seen.add((number, test))
        try:  # an empty file, for a process may have no descriptor and no byte left
            _link(test or f'at {_time()}', f'FOLDER/{number}-{_pid()}-{hash(test)}')
        except OSError:
            pass
"""
KINDS = ('comparison', 'check', 'off by one', 'unit', 'sign')
"""Flipped comparisons, dropped checks, integers and bounds one off, factors of units dropped,
plus for minus."""

Function = ast.FunctionDef | ast.AsyncFunctionDef
@dataclasses.dataclass(frozen=True)
class Fault:
    """A change of the code, and what detected it.

    Attributes:
        name: its room, kind and number.
        path: file in the package.
        function: qualified name.
        old: lines of the function, of which it has one such.
        new: lines instead.
        equivalent: why nothing can be observed of it; it is then not counted.
        caught: for each suite the test that failed, or none.
    """

    name: str
    room: str
    kind: str
    path: str
    function: str
    old: str
    new: str
    equivalent: str = ''
    caught: Mapping[str, str] = dataclasses.field(default_factory=dict)


class Source:
    """A file of the package.

    Attributes:
        path: where it is, in the package.
        functions: those of modules and classes, by qualified name.
    """

    def __init__(self, file: Path, path: str) -> None:
        self.path = path
        self.data = file.read_bytes()
        self._lines = [0]
        for line in self.data.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))
        self.functions = dict(_functions(ast.parse(self.data), ''))

    def span(self, node: ast.AST) -> tuple[int, int]:
        """Where a node begins and ends [byte]."""
        at: Any = node
        return (self._lines[at.lineno - 1] + at.col_offset,
                self._lines[at.end_lineno - 1] + at.end_col_offset)

    def lines(self, begin: int, end: int) -> tuple[int, int]:
        """Where the lines of a span begin and end [byte]."""
        last = self.data.find(b'\n', max(begin, end - 1))
        return self.data.rfind(b'\n', 0, begin) + 1, len(self.data) if last < 0 else last

    def text(self, node: ast.AST) -> str:
        """Source of a node, in whole lines."""
        begin, end = self.lines(*self.span(node))
        return self.data[begin:end].decode()


def _functions(node: ast.AST, prefix: str) -> Iterator[tuple[str, Function]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef):
            yield from _functions(child, f'{prefix}{child.name}.')
        elif isinstance(child, Function):
            yield prefix + child.name, child


def sources(tree: Path, folders: Sequence[str]) -> Iterator[Source]:
    """The files in folders of a checkout's package."""
    for folder in folders:
        for file in sorted((tree / PACKAGE / folder).rglob('*.py')):
            yield Source(file, file.relative_to(tree / PACKAGE).as_posix())


def places(faults: Sequence[Fault]) -> dict[str, tuple[Source, Function]]:
    """Where each fault is planted in this checkout; files and classes may have other names."""
    folders = [folder for room in ROOMS.values() for folder in room]
    by_name: dict[str, list[tuple[Source, str]]] = defaultdict(list)
    for source in sources(Path.cwd(), folders):
        for name in source.functions:
            by_name[name.rpartition('.')[2]].append((source, name))
    where = {}
    for fault in faults:
        fitting = [
            (source, name) for source, name in by_name[fault.function.rpartition('.')[2]]
            if source.text(source.functions[name]).count(fault.old) == 1
        ]
        same = [one for one in fitting if (one[0].path, one[1]) == (fault.path, fault.function)]
        if len(same or fitting) != 1:
            raise UsageError(f'{fault.name}: {fault.path}: {fault.function} has no longer the line '
                             f'{fault.old.strip()!r}; draw another')
        source, name = (same or fitting)[0]
        where[fault.name] = source, source.functions[name]
    return where


@contextlib.contextmanager
def changed(texts: Mapping[Path, bytes]) -> Iterator[None]:
    """Files of the package with other contents, meanwhile."""
    state = subprocess.run(['git', 'status', '--porcelain', PACKAGE], capture_output=True,
                           text=True, check=True)
    if state.stdout:
        raise UsageError(f'{PACKAGE} is not as committed: {state.stdout.splitlines()[0]}')
    before = {file: (file.read_bytes(), file.stat()) for file in texts if file.exists()}
    try:
        for file, text in texts.items():
            file.write_bytes(text)
        yield
    finally:
        for file in texts:
            if file in before:
                file.write_bytes(before[file][0])
                os.utime(file, ns=(before[file][1].st_atime_ns, before[file][1].st_mtime_ns))
            else:
                file.unlink()


def planted(fault: Fault, where: tuple[Source, Function]) -> dict[Path, bytes]:
    """A fault, for :func:`changed`."""
    source, function = where
    begin, end = source.lines(*source.span(function))
    body = source.data[begin:end].replace(fault.old.encode(), fault.new.encode())
    return {Path(PACKAGE, source.path): source.data[:begin] + body + source.data[end:]}


def probed(faults: Sequence[Fault], folder: Path) -> dict[Path, bytes]:
    """A call before the statement of each fault, which leaves a link in a folder."""
    lines: dict[Source, list[tuple[int, int]]] = defaultdict(list)
    for number, (source, function) in enumerate(places(faults).values()):
        begin, _ = source.lines(*source.span(function))
        at = begin + source.data[begin:].find(faults[number].old.encode())
        lines[source].append((_statement(source, function, at), number))
    texts = {Path(PACKAGE, _REACHED): _PROBE.replace('FOLDER', str(folder)).encode()}
    for source, found in lines.items():
        data = source.data
        for begin, number in sorted(found, reverse=True):
            indent = re.match(rb' *', data[begin:])
            call = f"__import__('{PACKAGE}.reached', fromlist=['hit']).hit({number})\n".encode()
            data = data[:begin] + (indent[0] if indent else b'') + call + data[begin:]
        texts[Path(PACKAGE, source.path)] = data
    return texts


def _statement(source: Source, function: Function, at: int) -> int:
    """Where the last line begins, up to a place, before which there can be a statement."""
    best = 0
    for node in ast.walk(function):
        if isinstance(node, ast.stmt) and node is not function:
            begin, end = source.span(node)
            line, _ = source.lines(begin, begin)
            first = source.data[line : begin + 4].lstrip(b' ')[:4]
            if first == source.data[begin : begin + 4] != b'elif' and line <= at < end:
                best = max(best, line)
    return best


def run_tests(
    tests: Sequence[str], files: Sequence[str], arguments: Sequence[str], limit_s: float,
) -> list[dict[str, Any]]:
    """Run tests with pytest; one more result, if it had to be ended."""
    WORK.mkdir(parents=True, exist_ok=True)
    order, results = (WORK / 'order.json').resolve(), (WORK / 'ended.jsonl').resolve()
    order.write_text(json.dumps(list(tests)))
    results.write_text('')
    code = f'sys.path.insert(0, {str(HERE)!r}); import chosen_tests; chosen_tests.main()'
    words = [sys.executable, '-c', f'import sys; {code}', str(order), str(results), '-q',
             '-p', 'no:cacheprovider', f'--timeout={_TEST_S}', *arguments, *files]
    with (WORK / 'pytest.log').open('wb') as log:
        child = subprocess.Popen(words, stdout=log, stderr=log, start_new_session=True,
                                 env={**os.environ, 'ROS_PYTHON_CHECK_FIELDS': '1'})
        try:
            code_of_end: int | str = child.wait(limit_s)
        except subprocess.TimeoutExpired:
            code_of_end = f'hangs for {limit_s:.0f} s'
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child.pid, signal.SIGKILL)
            child.wait()
    ended = [json.loads(line) for line in results.read_text().splitlines()]
    if code_of_end not in (0, 1) and not any(one['outcome'] == 'failed' for one in ended):
        ended.append({'test': f'pytest: {code_of_end}', 'outcome': 'failed', 'duration_s': 0.0,
                      'end_s': time.time(), 'why': ''})
    return ended


def find_reach(faults: Sequence[Fault], suite: str, arguments: Sequence[str]) -> dict[str, Any]:
    """Run a suite once and note the tests that reach each fault.

    Returns:
        ``tests``: time of each test [s]; ``direct``: for each fault the tests during whose call it
        is reached, in any process; ``files``: files of tests in which it is reached otherwise.
    """
    folder = (WORK / 'reached').resolve()
    folder.mkdir(parents=True, exist_ok=True)
    for link in folder.iterdir():
        link.unlink()
    with changed(probed(faults, folder)):
        ended = run_tests((), arguments or ['tests'], _marks(suite), 4 * 3600)
    room_of = {fault.name: fault.room for fault in faults}
    tests: Counter[str] = Counter()
    for one in ended:
        tests[one['test']] += one['duration_s']
    direct: dict[str, set[str]] = defaultdict(set)
    files: dict[str, set[str]] = defaultdict(set)
    for link in folder.iterdir():
        name = faults[int(link.name.partition('-')[0])].name
        test, _, part = os.readlink(link).rpartition(' ')
        if part == '(call)':
            direct[name].add(test)
        elif test == 'at':  # before, or beside, the tests: when a module is imported, in a child
            at_s, rooms = float(part), ROOMS[room_of[name]]
            running = {one['test'].partition('::')[0] for one in ended
                       if one['end_s'] - one['duration_s'] - 1 <= at_s <= one['end_s'] + 1}
            files[name].update(running or {
                file for file in (test.partition('::')[0] for test in tests)
                if file.split('/')[1] in rooms
            })
        else:
            files[name].add(test.partition('::')[0])
    return {
        'tests': tests,
        'failed': sorted({one['test'] for one in ended if one['outcome'] == 'failed'}),
        'direct': {name: sorted(found) for name, found in direct.items()},
        'files': {name: sorted(found) for name, found in files.items()},
    }


def _marks(suite: str) -> list[str]:
    return ['-n', '2', '--dist', 'loadfile', '--no-loadscope-reorder',
            *(['-m', SUITES[suite]] if SUITES[suite] else [])]


def batches(fault: Fault, reach: Mapping[str, Any]) -> Iterator[list[str]]:
    """Tests to run for a fault, those first that are quick and about its room.

    Last come all of files whose fixtures reach it, and of the folder of tests with its module's
    name: what is made once, or done in a process that serves several tests, is noted for one test.
    """
    times: Mapping[str, float] = reach['tests']
    direct = [test for test in reach['direct'].get(fault.name, ()) if test in times]
    by_file: dict[str, list[str]] = defaultdict(list)
    for test in sorted(direct, key=lambda test: times[test]):
        by_file[test.partition('::')[0]].append(test)
    rooms = ROOMS[fault.room]
    folder, _, module = fault.path.rpartition('/')
    files = sorted(by_file, key=lambda file: (
        module.removesuffix('.py') not in file, f'tests/{folder}/' not in file,
        file.split('/')[1] not in rooms, sum(times[test] for test in by_file[file][:_QUICKEST]),
    ))
    quick, spent = [], 0.0
    for file in files[:_FIRST_FILES]:
        for test in by_file[file][:_QUICKEST]:
            if spent + times[test] <= _QUICK_S or not quick:
                quick.append(test)
                spent += times[test]
    shared = {*reach['files'].get(fault.name, ()), *(
        test.partition('::')[0] for test in times
        if test.partition('::')[0].rpartition('/')[0] == f'tests/{folder}')}
    done = set(quick)
    for batch in (
        quick, [test for file in files for test in by_file[file] if test not in done],
        sorted((test for test in times if test.partition('::')[0] in shared
                and test not in direct), key=lambda test: test.partition('::')[0]),
    ):
        if batch:
            yield batch


def judge(
    fault: Fault, reach: Mapping[str, Any], skipped: Sequence[str], *, quick: bool,
) -> dict[str, Any]:
    """Plant a fault and run what reaches it, or only what is quick, until a test fails."""
    begun, tests = time.monotonic(), 0
    where = places([fault])[fault.name]
    for batch in itertools.islice(batches(fault, reach), 1 if quick else None):
        chosen = [test for test in batch if test not in skipped]
        files = list(dict.fromkeys(test.partition('::')[0] for test in chosen))
        limit_s = 300 + 10 * sum(reach['tests'][test] for test in chosen)
        with changed(planted(fault, where)):
            ended = run_tests(chosen, files, ['-x'], limit_s)
        tests += len({one['test'] for one in ended})
        failed = [one for one in ended if one['outcome'] == 'failed']
        if failed:
            return {'caught': failed[0]['test'], 'why': failed[0]['why'], 'tests': tests,
                    'wall_s': time.monotonic() - begun}
    return {'caught': '', 'tests': tests, 'wall_s': time.monotonic() - begun}


def caught_again(fault: Fault, suite: str) -> dict[str, Any]:
    """Plant a fault and run the suite's test that caught it before, wherever that is now."""
    begun = time.monotonic()
    file, _, name = fault.caught[suite].partition('[')[0].partition('::')
    tests = [f'{place}::{name}' for place in sorted(Path('tests').rglob('test_*.py'))
             if f'def {name}(' in place.read_text()] if name else [file.partition(' ')[0]]
    if not tests:
        return {'caught': '', 'tests': 0, 'wall_s': 0.0}
    with changed(planted(fault, places([fault])[fault.name])):
        marks = ['-m', SUITES[suite]] if SUITES[suite] else []
        ended = run_tests((), tests, ['-x', *marks], 600)
    failed = [one for one in ended if one['outcome'] == 'failed']
    first = failed[0] if failed else {'test': '', 'why': ''}
    return {'caught': first['test'], 'why': first['why'],
            'tests': len({one['test'] for one in ended}), 'wall_s': time.monotonic() - begun}


def read_faults(file: Path) -> list[Fault]:
    """The faults of a file."""
    return [Fault(**json.loads(line)) for line in file.read_text().splitlines()]


def write_faults(faults: Sequence[Fault], file: Path) -> None:
    """Write faults, one a line."""
    file.write_text(''.join(json.dumps(dataclasses.asdict(one)) + '\n' for one in faults))


def take_up(file: Path, results: Sequence[Path]) -> None:
    """Note in the file of the faults what has caught them."""
    faults = {fault.name: fault for fault in read_faults(file)}
    for line in (line for one in results for line in one.read_text().splitlines()):
        found = json.loads(line)
        fault = faults[found['name']]
        faults[fault.name] = dataclasses.replace(
            fault, caught={**fault.caught, found['suite']: found['caught']})
    write_faults(list(faults.values()), file)


def show(faults: Sequence[Fault]) -> None:
    """Print the counts of each kind in each room, and what survived."""
    counted = [fault for fault in faults if not fault.equivalent]
    table = make_table(['room', 'fault'], ['faults', 'fast', 'both', 'missed', 'caught before'])
    for room, kind in [*((room, kind) for room in ROOMS for kind in KINDS), ('all', '')]:
        here = [one for one in counted if room == 'all' or (one.room, one.kind) == (room, kind)]
        fast = sum(bool(fault.caught.get('fast')) for fault in here)
        missed = [fault for fault in here
                  if not (fault.caught.get('fast') or fault.caught.get('nightly'))]
        before = sum(bool(fault.caught.get('before')) for fault in missed)
        table.add_row(room, kind, *map(str, (len(here), fast, len(here) - len(missed), len(missed),
                                             before)))
    console = page_console()
    console.print(table)
    for fault in counted:
        if not fault.caught.get('fast'):
            console.print(f'{fault.name}: {fault.path}: {fault.function}: {dict(fault.caught)}')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n\n')[0])
    parser.add_argument('command', choices=('reach', 'run', 'again', 'table'))
    parser.add_argument('words', nargs='*', metavar='WORD', help=(
        'reach: test files, else all; run: names of faults, or their beginnings, else all; table: '
        'files of results to take up'))
    parser.add_argument('--suite', choices=SUITES, default='fast')
    parser.add_argument('--faults', type=Path, default=FAULTS, metavar='FILE')
    parser.add_argument('--skip', action='append', default=[], metavar='TEST',
                        help='run: a test that fails without faults, too')
    parser.add_argument('--quick', action='store_true',
                        help='run: only what is tried first; what survives it is not noted')
    given = parser.parse_args(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(ExitCode.INFRA))  # having put back the file
    faults = [fault for fault in read_faults(given.faults) if not fault.equivalent]
    reach_file = WORK / f'reach_{given.suite}.json'
    if given.command == 'reach':
        reach = find_reach(faults, given.suite, given.words)
        reach_file.write_text(json.dumps(reach))
        print(f'{len(reach["tests"])} tests, of which {len(reach["failed"])} failed')
    elif given.command in ('run', 'again'):
        if given.command == 'run' and not reach_file.exists():
            raise UsageError(f'{reach_file}: there is none; first: reach --suite {given.suite}')
        reach = json.loads(reach_file.read_text()) if given.command == 'run' else {}
        if given.command == 'again':
            faults = [fault for fault in faults if fault.caught.get(given.suite)]
        resource.setrlimit(resource.RLIMIT_DATA, (_MEMORY_BYTES, _MEMORY_BYTES))
        for fault in faults:
            if not given.words or fault.name.startswith(tuple(given.words)):
                found = {'name': fault.name, 'suite': given.suite,
                         **(judge(fault, reach, given.skip, quick=given.quick) if reach
                            else caught_again(fault, given.suite))}
                if found['caught'] or not given.quick:
                    with (WORK / 'results.jsonl').open('a') as file:
                        file.write(json.dumps(found) + '\n')
                print(f'{fault.name}: {found["caught"] or "survived"}', flush=True)
    else:
        take_up(given.faults, [Path(word) for word in given.words])
        show(read_faults(given.faults))
    return ExitCode.OK


if __name__ == '__main__':
    leave(main)
