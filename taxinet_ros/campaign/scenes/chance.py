"""Detection of randomness and clocks outside Scenic while a program is compiled.

A draw from Python's ``random`` happens once, at compile time, so its value is the same in all runs
although the program reads as if it varied. A clock or the operating system's entropy gives a
different program in each worker and after each interruption. Both are refused with their line. A
generator with its own seed (``random.Random(3)``) explicitly gives the same numbers in all runs and
is allowed; Scenic and the libraries may draw internally.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import ast
import datetime
import linecache
import logging
import os
import random
import re
import sys
import sysconfig
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FrameType
from typing import Any, TypeVar

import numpy as np
import scenic

from taxinet_ros.campaign.scenes.programs import MODEL, SUFFIX, shipped_folder
from taxinet_ros.campaign.scenes.values import Place, ProgramError

Compiled = TypeVar('Compiled')

_SCENIC, _LOGGING = (str(Path(module.__file__ or '').parent) for module in (scenic, logging))
_LIBRARIES = tuple({sysconfig.get_path(kind)
                    for kind in ('stdlib', 'platstdlib', 'purelib', 'platlib')})
_IMPORTING = '<frozen importlib'

_CLOCKS = {
    f'time.{name}' for name in (
        'time', 'time_ns', 'monotonic', 'monotonic_ns', 'perf_counter', 'perf_counter_ns',
        'process_time', 'process_time_ns', 'localtime', 'gmtime', 'ctime', 'strftime',
    )
}
_DATES = ('now', 'utcnow', 'today')
_ENTROPY = {'os.urandom', 'os.getrandom'}
_OUTSIDE = {getattr({'time': time, 'os': os}[module], name)
            for module, _, name in (word.partition('.') for word in _CLOCKS | _ENTROPY)
            if hasattr({'time': time, 'os': os}[module], name)}
_FUNCTION, _SEED = type(time.time), random.Random.seed.__code__
_IN_TEXT = re.compile(
    rf'({"|".join(map(re.escape, sorted(_CLOCKS | _ENTROPY)))}'
    rf'|((datetime|date)\.)+({"|".join(_DATES)})|uuid\.uuid[14]|secrets\.\w+)'
)

_REACHES = re.compile(rf'import|^\s*model\s+(?!{MODEL}\s*$)', re.MULTILINE)

_COMMON: random.Random = random.random.__self__  # type: ignore[attr-defined]
"""The generator behind the functions of ``random``."""

_MENDS = (
    (re.compile(r'uniform\(([^()]+)\)'), r'Range(\1)'),
    (re.compile(r'randint\(([^()]+)\)'), r'DiscreteRange(\1)'),
    (re.compile(r'(?:gauss|normal|normalvariate)\(([^()]+)\)'), r'Normal(\1)'),
    (re.compile(r'choice\(([^()]+)\)'), r'Uniform(*\1)'),
)


def compile_watched(program: Path, compile_program: Callable[[], Compiled]) -> Compiled:
    """Compile a program; refuse random draws and clock reads outside Scenic.

    Args:
        program: the program. Watching takes three times as long as compiling, so one that imports
            nothing but our world model is only compiled.
        compile_program: compiles it.

    Raises:
        ProgramError: the first such call, its line, and what to write instead.
    """
    if not _imports(program):
        return compile_program()
    watch = _Watch()
    before = _numpy_state()
    sys.setprofile(watch.profile)
    try:
        compiled = compile_program()
    finally:
        sys.setprofile(None)
    if watch.found is not None:
        raise watch.found
    if _numpy_state() != before:
        _refuse_numpy(compile_program)
    return compiled


def check_clocks(nodes: Iterable[ast.AST], filename: str) -> None:
    """Refuse clocks in a program's source: a function may read one for each scene."""
    for node in nodes:
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name = ast.unparse(node.func)
            if _IN_TEXT.fullmatch(name):
                raise _reads(name, (filename, node.lineno))


def _imports(program: Path) -> bool:
    """Whether a program may reach code other than Scenic's and that of our world model."""
    own_model = program.parent / f'{MODEL}{SUFFIX}'
    if own_model.exists() and not own_model.samefile(shipped_folder() / own_model.name):
        return True
    return bool(_REACHES.search(program.read_text(encoding='utf-8', errors='replace')))


class _Watch:
    """Observes every Python and C call except calls from C to C, such as NumPy's."""

    def __init__(self) -> None:
        self.found: ProgramError | None = None

    def profile(self, frame: FrameType, event: str, called: Any) -> None:
        if self.found is None and event == 'c_call':
            self._c_call(frame, called)
        elif (self.found is None and event == 'call' and frame.f_code is _SEED
              and frame.f_locals.get('a') is None):  # from the operating system
            self._note(frame.f_back, 'random.seed', _reads)

    def _c_call(self, frame: FrameType, called: Any) -> None:
        owner, name = getattr(called, '__self__', None), called.__name__
        if owner is _COMMON and name in {'random', 'getrandbits', 'seed'}:
            self._note(frame, f'random.{name}', _draws)
        elif name in _DATES and isinstance(owner, type) and issubclass(owner, datetime.date):
            self._note(frame, f'{owner.__name__}.{name}', _reads)
        elif type(called) is _FUNCTION and called in _OUTSIDE:
            module = {'posix': 'os'}.get(called.__module__, called.__module__)
            self._note(frame, f'{module}.{name}', _reads)

    def _note(
        self, frame: FrameType | None, name: str, refusal: Callable[[str, Place], ProgramError]
    ) -> None:
        if place := _of_program(frame):
            self.found = refusal(_written(place) or name, place)


def _of_program(frame: FrameType | None) -> Place | None:
    """The program line that caused the call; None if Scenic or a library made it internally."""
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith((_SCENIC, _LOGGING, _IMPORTING)):
            return None
        if not name.startswith((*_LIBRARIES, '<')):
            return name, frame.f_lineno
        frame = frame.f_back
    return None


def _refuse_numpy(compile_again: Callable[[], Any]) -> None:
    """Recompile to find the line that draws from NumPy's generator."""
    np.random.seed(1)  # noqa: NPY002 (the program may seed it too)
    before = _numpy_state()
    trace = _Trace()
    sys.settrace(trace.enter)
    try:
        compile_again()
    finally:
        sys.settrace(None)
    if trace.found is not None:
        raise trace.found
    if _numpy_state() == before:  # an imported module does not run again
        raise _draws('numpy.random, in a module that it imports,', None)


class _Trace:
    """Checks NumPy's generator after each line of a program and its neighbouring modules."""

    def __init__(self) -> None:
        self.found: ProgramError | None = None
        self._state = _numpy_state()
        self._scenic = False
        self._lines: dict[int, int] = {}

    def enter(self, frame: FrameType, _event: str, _: Any) -> Any:
        name = frame.f_code.co_filename
        self._scenic |= name.startswith(_SCENIC)
        if self.found is not None or name.startswith((*_LIBRARIES, '<')):
            return None
        if frame.f_back is not None and id(frame.f_back) in self._lines:
            self._look(frame.f_back)
        self._lines[id(frame)] = frame.f_lineno
        return self._line

    def _line(self, frame: FrameType, event: str, _: Any) -> Any:
        self._look(frame)
        self._lines[id(frame)] = frame.f_lineno
        if event == 'return':
            del self._lines[id(frame)]
        return self._line

    def _look(self, frame: FrameType) -> None:
        """Record a draw, unless Scenic made it internally in a line without a NumPy call."""
        now, place = _numpy_state(), (frame.f_code.co_filename, self._lines[id(frame)])
        name = _written(place) or ('' if self._scenic else 'numpy.random')
        if name and now != self._state and self.found is None:
            self.found = _draws(name, place)
        self._state, self._scenic = now, False


def _numpy_state() -> Any:
    state: Any = np.random.get_state()  # noqa: NPY002 (the one Scenic uses)
    _, words, position, *rest = state
    return words.tobytes(), position, *rest


_CALL = re.compile(r'[\w.]*\b(?:random|uniform|randint|randrange|gauss|normal\w*|choices?|shuffle|'
                   r'sample|rand|randn|seed|default_rng|time|time_ns|monotonic|perf_counter|now|'
                   r'today|utcnow|urandom|uuid[14]|randbelow|randbits|token_\w+|Random|'
                   r'RandomState|SystemRandom|localtime|strftime)(?=\()')


def _written(place: Place) -> str:
    """The call as written in the program."""
    found = _CALL.search(linecache.getline(*place))
    return found.group() if found else ''


def _draws(name: str, place: Place | None) -> ProgramError:
    if name.endswith('seed'):
        return ProgramError(f'{name} has no effect here: scenes are drawn by --seed; leave it out',
                            place)
    line = linecache.getline(*place) if place else ''
    mends = [found.expand(mend) for kind, mend in _MENDS if (found := kind.search(line))]
    mend = mends[0] if mends else 'Range(LOW, HIGH)'
    return ProgramError(f'write {mend} instead: {name} is drawn once for all runs', place)


def _reads(name: str, place: Place) -> ProgramError:
    return ProgramError(
        f'{name} is another one each time the program is compiled, so no run could be repeated; '
        'write a number, or Range(LOW, HIGH) for chance', place,
    )
