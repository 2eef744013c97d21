"""Programs that are another one each time they are compiled: chance and clocks outside Scenic.

A draw from Python's ``random`` happens once, at compile time, so its value would be the same in all
runs although the program reads as if it varied. A clock or the operating system's entropy gives a
different program in each worker and after each interruption. So a program is compiled twice, from
different seeds, and has to draw the same scenes. A generator with a seed of its own
(``random.Random(3)``) does so.

Only the Scenic child may import this module.
"""

from __future__ import annotations

import random
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from taxinet_ros.scenes.programs import MODEL, SUFFIX, shipped_folder
from taxinet_ros.scenes.values import Place, ProgramError

Compiled = TypeVar('Compiled')

_LIBRARIES = tuple({
    sysconfig.get_path(kind) for kind in ('stdlib', 'platstdlib', 'purelib', 'platlib')
})
_SEEDS = 10
"""Compilations of a program that draws while it is compiled."""
_CLOCK = re.compile(
    r'\b(?:now|utcnow|today|time|time_ns|localtime|gmtime|strftime|ctime|perf_counter|monotonic|'
    r'urandom|getpid|getppid|randbelow|randbits|token_\w+|uuid[14]|SystemRandom)\('
)
"""What may be the same in two compilations, and another tomorrow or in another process."""
_REACHES = re.compile(
    rf'import|\b(?:open|id|hash)\(|^\s*model\s+(?!{MODEL}\s*$)', re.MULTILINE
)
_CHANCE = re.compile(
    r'\b(?:random|uniform|gauss|normal\w*|choices?|shuffle|rand\w*|default_rng|Random|token_\w+|'
    r'time\w*|monotonic|perf_counter|urandom|uuid[14])\('
)


def compile_twice(
    program: Path, compile_program: Callable[[], Compiled], reseed: Callable[[int], None],
    first_scenes: Callable[[Compiled], Any],
) -> Compiled:
    """Compile a program; refuse one that is another each time.

    Args:
        program: its file. One that imports nothing but our world model is only compiled once, as
            it reaches no chance and no clock.
        compile_program: compiles it.
        reseed: seeds the generators that a program may draw from; the scenario that is returned
            is compiled after ``reseed(0)``.
        first_scenes: draws some scenes, with seeds of their own.

    Raises:
        ProgramError: it differs, and the line that seems to be the reason.
    """
    if not _imports(program):
        reseed(0)
        return compile_program()
    drawn: list[Any] = []

    def compiled_after(seed: int) -> tuple[Compiled, bool]:
        imported = set(sys.modules)
        reseed(seed)
        before = _generators()
        compiled = compile_program()
        moved = _generators() != before
        drawn.append(first_scenes(compiled))
        if drawn[-1] != drawn[0]:
            raise ProgramError(
                'compiled twice, it draws other scenes: chance outside Scenic, or a clock, is '
                'another one each time, so no run could be repeated; write a number, or '
                'Range(LOW, HIGH) for chance', _line(program, _CHANCE),
            )
        if seed:
            _forget(set(sys.modules) - imported)
        return compiled, moved

    _, moved = compiled_after(1)
    # Of two choices, one in two compilations is the same by chance.
    for seed in range(2, _SEEDS if moved else 2):
        compiled_after(seed)
    return compiled_after(0)[0]


def check_clocks(program: Path, files: Iterable[str]) -> None:
    """Refuse what answers equally in two compilations, but otherwise another day or elsewhere.

    Args:
        program: a program's file.
        files: what was read while it was compiled.

    Raises:
        ProgramError: a line of its own code, or of a module below its folder, asks for such.
    """
    folder = program.absolute().parent
    for file in map(Path, files):
        own = file.suffix in ('.py', SUFFIX) and file.is_relative_to(folder)
        if own and not str(file).startswith(_LIBRARIES) and (place := _line(file, _CLOCK)):
            raise ProgramError(
                'the clock, the process and the system answer otherwise another day or in another '
                'process, so no run could be repeated; write a number, or Range(LOW, HIGH)', place
            )


def _imports(program: Path) -> bool:
    """Whether a program may reach code other than Scenic's and that of our world model."""
    own_model = program.parent / f'{MODEL}{SUFFIX}'
    if own_model.exists() and not own_model.samefile(shipped_folder() / own_model.name):
        return True
    return bool(_REACHES.search(program.read_text(encoding='utf-8', errors='replace')))


def _generators() -> tuple[Any, ...]:
    """State of the generators that Scenic draws from, which it does not while it compiles."""
    state: Any = np.random.get_state()  # noqa: NPY002 (the one Scenic uses)
    _, words, position, *rest = state
    return random.getstate(), words.tobytes(), position, *rest


def _forget(modules: set[str]) -> None:
    """Have Python modules of a program run again, as its Scenic modules do."""
    for name in modules:
        file = getattr(sys.modules[name], '__file__', None)
        if file and not file.startswith(_LIBRARIES):
            del sys.modules[name]


def _line(program: Path, words: re.Pattern[str]) -> Place | None:
    """The first line of a program that has one of these words."""
    try:
        lines = program.read_text(encoding='utf-8', errors='replace').splitlines()
    except OSError:  # Scenic says so
        return None
    for number, line in enumerate(lines, 1):
        if words.search(line.partition('#')[0]):
            return str(program), number
    return None
