"""Programs that are another one each time they are compiled: chance and clocks outside Scenic.

A draw from Python's ``random`` happens once, at compile time, so its value would be the same in all
runs although the program reads as if it varied. A clock or the operating system's entropy gives a
different program in each worker and after each interruption. So a program is compiled twice, once
in a fork with other seeds on another day, and has to draw the same scenes. A generator with a seed
of its own (``random.Random(3)``) does so.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import random
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from taxinet_ros.processes.child import die_with_parent
from taxinet_ros.scenes.programs import MODEL, SUFFIX, shipped_folder
from taxinet_ros.scenes.values import Place, ProgramError

Compiled = TypeVar('Compiled')

_MORE = 7
"""Further compilations where entropy was asked for: two that choose one of two may be the same."""
_LATER_S = 400 * 86400 + 5 * 3600 + 1234.5
_REACHES = re.compile(
    rf'import|\b(?:open|id|hash)\(|^\s*model\s+(?!{MODEL}\s*$)', re.MULTILINE
)


def compile_twice(
    program: Path, compile_program: Callable[[], Compiled], reseed: Callable[[int], None],
    first_scenes: Callable[[Compiled], list[Any]],
    place_of: Callable[[str, Compiled], Place | None],
) -> Compiled:
    """Compile a program; refuse one that is another each time.

    Args:
        program: its file. One that imports nothing but our world model is only compiled once, as
            it reaches no chance and no clock.
        compile_program: compiles it.
        reseed: seeds the generators that a program may draw from; the scenario that is returned
            is compiled after ``reseed(0)``.
        first_scenes: draws some scenes, with seeds of their own.
        place_of: where a compiled program says a value of its scenes.

    Raises:
        ProgramError: it differs: in which value, and the line that says it.
    """
    def once(seed: int) -> tuple[Compiled, dict[str, str]]:
        reseed(seed)
        before = _generators()
        compiled = compile_program()
        return compiled, dict(_generators().items() - before.items())

    if not _imports(program):
        return once(0)[0]
    others = [_elsewhere(lambda: once(1), first_scenes)]
    if others[0] is not None and others[0]['asked']:
        others += [_elsewhere(lambda: once(1), first_scenes) for _ in range(_MORE)]
    compiled, drawn_from = once(0)
    scenes = json.loads(json.dumps(first_scenes(compiled)))
    for other in others:
        if other is None:
            raise ProgramError(
                'compiled a second time, on another day, it ends otherwise or not in time'
            )
        if other['scenes'] != scenes:
            what, place = _difference(scenes, other['scenes'], compiled, place_of)
        elif drawn_from != other['drawn_from']:
            names = ' and '.join(sorted({*drawn_from, *other['drawn_from']}))
            what, place = f'it draws from {names} without a seed of its own', None
        else:
            continue
        raise ProgramError(
            f'compiled twice, {what}: chance outside Scenic, a clock or the process is another one '
            'each time, so no run could be repeated; write a number, or Range(LOW, HIGH) for '
            'chance', place,
        )
    return compiled


def _difference(
    scenes: list[Any], others: list[Any], compiled: Compiled,
    place_of: Callable[[str, Compiled], Place | None],
) -> tuple[str, Place | None]:
    """What differs between the scenes of two compilations, and where the program says it."""
    for one, other in zip(scenes, others, strict=True):
        if 'values' in one and 'values' in other:
            values, rest = one['values'], other['values']
            for key in values:
                if values[key] != rest.get(key):
                    shown = f'{values[key]!s:.40} and {rest.get(key)!s:.40}'
                    return f'{key} is {shown}', place_of(key, compiled)
    return 'its scenes meet other requirements', None


def _elsewhere(
    once: Callable[[], tuple[Compiled, dict[str, str]]],
    first_scenes: Callable[[Compiled], list[Any]],
) -> dict[str, Any] | None:
    """What a program draws in a fork of this process, on another day; None if it fails there."""
    left_s = signal.getitimer(signal.ITIMER_REAL)[0]
    answer, theirs = os.pipe()
    pid = os.fork()
    if not pid:
        try:
            die_with_parent(signal.SIGKILL)
            signal.setitimer(signal.ITIMER_REAL, left_s / 2)  # the rest is to name the line
            ballast = [bytes(size) for size in range(1, 512) for _ in range(9)]  # other addresses
            del ballast[::2]
            asked = _another_day()
            compiled, drawn_from = once()
            data = {'scenes': first_scenes(compiled), 'drawn_from': drawn_from, 'asked': asked}
            with open(theirs, 'w') as stream:
                json.dump(data, stream)
        except BaseException:  # of the program: it is reported where it is compiled for use
            pass
        finally:
            os._exit(0)
    os.close(theirs)
    try:
        with open(answer) as stream:
            text = stream.read()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
    return json.loads(text) if text else None


def _another_day() -> list[bool]:
    """Set the clocks of this process forward, as Python tells them.

    Returns:
        A list that is filled when it asks for entropy.
    """
    for name in ('localtime', 'gmtime', 'ctime'):
        _default(name, 0, lambda: time.time())
    _default('asctime', 0, lambda: time.localtime())
    _default('strftime', 1, lambda: time.localtime())
    for name in ('time', 'monotonic', 'perf_counter', 'process_time', 'thread_time'):
        _set_forward(name, _LATER_S)
        _set_forward(f'{name}_ns', int(1e9 * _LATER_S))

    class Later(datetime.datetime):
        @classmethod
        def now(cls, tz: datetime.tzinfo | None = None) -> Later:
            return cls.fromtimestamp(time.time(), tz)

        @classmethod
        def utcnow(cls) -> Later:
            return cls.utcfromtimestamp(time.time())

    datetime.datetime = Later  # type: ignore[misc]  # for whoever imports it later
    asked: list[bool] = []
    entropy = os.urandom

    def urandom(size: int) -> bytes:
        asked.append(True)
        return entropy(size)

    os.urandom = random._urandom = urandom  # type: ignore[attr-defined]  # not in stubs
    return asked


def _set_forward(clock: str, by: float) -> None:
    now = getattr(time, clock)
    setattr(time, clock, lambda: now() + by)


def _default(function: str, index: int, default: Callable[[], Any]) -> None:
    """Have a function of the module time take the default that is set forward."""
    given = getattr(time, function)
    setattr(time, function, lambda *args: given(*args, *([default()][len(args) - index:])))


def _imports(program: Path) -> bool:
    """Whether a program may reach code other than Scenic's and that of our world model."""
    own_model = program.parent / f'{MODEL}{SUFFIX}'
    if own_model.exists() and not own_model.samefile(shipped_folder() / own_model.name):
        return True
    return bool(_REACHES.search(program.read_text(encoding='utf-8', errors='replace')))


def _generators() -> dict[str, str]:
    """State of the generators that Scenic draws from, which it does not while it compiles."""
    state: Any = np.random.get_state()  # noqa: NPY002 (the one Scenic uses)
    numpy_state = state[1].tolist(), *state[2:]
    return {'random': str(random.getstate()), 'numpy.random': str(numpy_state)}
