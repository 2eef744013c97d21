"""What is checked for every command before it begins: its numbers, and the files it would write.

A number from the command line is finite. A file that an option names to be written
(``typer.Option(writable=True)``) replaces no record, no input and nothing but a regular file.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand

from taxinet_ros.errors import UsageError

RECORD_NAMES = frozenset({
    'campaign.db', 'progress.db', 'runs.csv', 'runs.parquet', 'learned.json',
    'metadata.yaml', 'stack.json', 'experiment.json',
    'pairs.parquet', 'analysis.json', 'localize.json', 'localize.parquet', 'localize.csv',
    'assurance.json', 'trials.csv', 'alarms.csv', 'rounds.json', 'dataset.json', 'labels.csv',
    'labels.parquet', 'evidence.json', 'MANIFEST',
})
"""Names of files in which campaigns, experiments, studies, data sets and bags are recorded."""

_RECORDING = '.mcap'
_SUFFIX = re.compile(r'\.\w+')


class CheckedCommand(TyperCommand):
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


def tell_doubts(lines: Iterable[str]) -> None:
    """Print warnings, one line each, on standard error."""
    for line in lines:
        print(f'warning: {line}', file=sys.stderr)


def check_output(
    where: str, path: Path, *, inputs: Iterable[Path] = (), folder: bool = False,
    own: Sequence[str] = (),
) -> None:
    """Refuse to write a file in the place of a record, an input or what is no regular file.

    An earlier output of the same kind, known by its suffix, may be replaced, if the command does.

    Args:
        where: option and value, which begin the message.
        path: the file.
        inputs: files that the command reads.
        folder: whether a folder may be there.
        own: suffixes of the files that the option writes, which it may replace.

    Raises:
        UsageError: it would destroy something.
    """
    if path.is_dir():
        if folder:
            return
        raise UsageError(f'{where}: is a folder; name a file')
    there = path.exists()
    if there and not path.is_file():
        raise UsageError(f'{where}: is not a regular file; choose another name')
    names = {path.name, path.resolve().name}
    if any(name.endswith(_RECORDING) for name in names):
        raise UsageError(f'{where}: {_RECORDING} is the name of a recording; choose another name')
    beside = path.parent
    if names & RECORD_NAMES and (there or _holds_records(beside)):
        raise UsageError(f'{where}: is the name of a record in {beside}; choose another name')
    if not there:
        return
    if any(_same(path, one) for one in inputs):
        raise UsageError(f'{where}: is read by this command; choose another name')
    if path.suffix not in own:
        if own:
            raise UsageError(f'{where}: exists, and is no {own[0]} file; choose another name')
        raise UsageError(f'{where}: already exists and is not overwritten; choose a new name')


def _holds_records(folder: Path) -> bool:
    return any((folder / name).exists() for name in RECORD_NAMES) or any(
        folder.glob(f'*{_RECORDING}'))


def _same(path: Path, other: Path) -> bool:
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # not there, or no path
        return False


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
