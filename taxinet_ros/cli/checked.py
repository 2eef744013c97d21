"""What is checked for every command before it begins: its numbers, and the files it would write.

A number from the command line is finite. A file that an option names to be written
(``typer.Option(writable=True)``) replaces no record, no input and nothing but a regular file.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import typer

from taxinet_ros.cli.help import PagedCommand
from taxinet_ros.errors import UsageError
from taxinet_ros.files.outputs import check_output

_SUFFIX = re.compile(r'\.\w+')


class CheckedCommand(PagedCommand):
    """A command that begins only if its numbers are finite and its output replaces no record."""

    def invoke(self, ctx: Any) -> Any:
        """Check the parameters, and run the command.

        Raises:
            UsageError: a number is not finite, or an output would destroy something.
        """
        for param in self.params:
            _check_numbers(_name(param), ctx.params.get(param.name))
        for param, path in outputs(self, ctx.params):
            info = _info(param)
            given = (value for name, value in ctx.params.items() if name != param.name)
            check_output(
                f'{_name(param)} {path}', path, inputs=_paths(given), folder=info.dir_okay,
                own=_SUFFIX.findall(info.metavar or ''),
            )
        return super().invoke(ctx)


def check_commands(app: typer.Typer) -> None:
    """Make every command of an app, and of the apps in it, a :class:`CheckedCommand`."""
    for info in app.registered_commands:
        info.cls = CheckedCommand
    for group in app.registered_groups:
        if group.typer_instance is not None:
            check_commands(group.typer_instance)


def outputs(command: Any, params: dict[str, Any]) -> Iterator[tuple[Any, Path]]:
    """Options of a command that name a file to write, and what they are given."""
    for param in command.params:
        path = params.get(param.name)
        if isinstance(path, Path) and getattr(_info(param), 'writable', False):
            yield param, path


def check_new_file(path: Path, option: str = '--out') -> None:
    """Check that a file that an option names to be written is new, and that its folder exists.

    Raises:
        UsageError: it is not.
    """
    if path.exists() or path.is_symlink():
        raise UsageError(
            f'{option} {path}: already exists and is not overwritten; choose a new name')
    if not path.parent.is_dir():
        raise UsageError(f'{option} {path}: no such folder: {path.parent}; make it first')


def tell_doubts(lines: Iterable[str]) -> None:
    """Print warnings, one line each, on standard error."""
    for line in lines:
        print(f'warning: {line}', file=sys.stderr)


def _check_numbers(name: str, value: Any) -> None:
    for one in value if isinstance(value, list | tuple) else (value,):
        if isinstance(one, float) and not math.isfinite(one):
            raise UsageError(f'{name} {one}: expected a finite number')


def _paths(values: Iterable[Any]) -> Iterator[Path]:
    """All paths that the values may name: as they are, as FILE:NAME, KEY=FILE or FILE=COUNT."""
    for value in values:
        for one in value if isinstance(value, list | tuple) else (value,):
            if isinstance(one, Path):
                yield one
            elif isinstance(one, str):
                words = {one, *one.partition('=')[::2], one.rpartition('=')[0]}
                words |= {word.partition(':')[0] for word in words}
                yield from (Path(word) for word in words if word and '\0' not in word)


def _name(param: Any) -> str:
    return str(max(param.opts, key=len))


def _info(param: Any) -> Any:
    return getattr(getattr(param, 'type_descriptor', None), 'parameter_info', None)
