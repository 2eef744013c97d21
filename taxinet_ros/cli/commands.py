"""All commands: their names in sections, and where they are.

Only the module of the command that is called is imported. Commands of :mod:`taxinet_ros.registry`,
of shipped extras and of other packages, are called in the same way.
"""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from textwrap import shorten
from typing import Any

import typer
from typer.core import TyperGroup

import taxinet_ros
from taxinet_ros.cli.checked import check_commands
from taxinet_ros.cli.help import add_examples
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import COMMANDS, SHIPPED, Extension, find, installed

SECTIONS: Mapping[str, Mapping[str, str]] = {
    'Run scenes': {
        'demo': 'run.demo:demo',
        'run': 'run.run:run',
        'keys': 'run.keys:keys',
        'up': 'run.up:up',
        'node': 'run.node:node',
        'check-node': 'run.check_node:check_node',
    },
    'Search for failures': {
        'falsify': 'run.falsify:falsify',
        'estimate': 'run.estimate:estimate',
    },
    'Find the causes': {
        'why': 'study.why:why',
        'analyze': 'analysis.analyze:analyze',
        'localize': 'analysis.localize:localize',
        'explain': 'analysis.explain:explain',
        'shrink': 'run.shrink:shrink',
        'fork': 'analysis.fork:fork',
        'experiment': 'run.experiment:experiment',
    },
    'Judge': {
        'check': 'analysis.check:check',
        'plan': 'analysis.plan:plan',
        'gate': 'analysis.gate:gate',
        'odd': 'analysis.odd:odd',
        'forecast': '',
        'compare': 'analysis.compare:compare',
        'bisect': 'analysis.bisect:bisect',
        'monitor': 'analysis.monitor:monitor',
        'assure': '',
        'evidence': '',
        'spec': 'analysis.spec:spec',
        'mine': 'analysis.mine:mine',
        'evaluate': 'training.evaluate:evaluate',
        'score': 'analysis.score:score',
    },
    'Train': {
        'dataset': 'training.dataset:dataset',
        'train': 'training.train:train',
        'network': 'training.foreign_network:network_app',
        'improve': 'study.improve:improve',
        'tune': '',
        'case-study': 'study.case_study:case_study',
    },
    'Worlds and cameras': {
        'place': 'run.place:place',
        'aircraft': 'training.aircraft:aircraft',
        'camera': 'training.camera:camera',
        'frame': 'training.frame:frame',
        'flightgear': '',
        'xplane': '',
    },
    'Recordings and tools': {
        'bag': 'bag.commands:bag_app',
        'doctor': 'doctor:doctor',
        'setup-messages': 'messages:setup_messages',
        'plugins': 'run.plugins:plugins',
        'bench': 'bench.commands:bench',
    },
}
"""Sections in the order of the workflow, and their commands by name: the module below
``taxinet_ros.cli`` and the attribute; '' for a shipped extra, which the registry knows."""

OWN = {name: target for section in SECTIONS.values() for name, target in section.items()}
"""Commands of this package by name. No other package can have the name of one."""

_ONE_LINE = 45
"""Characters of a description beside a completion: shells take a second line for names."""
_CONTEXT_SETTINGS = {'node': {'ignore_unknown_options': True, 'allow_extra_args': True}}


def added() -> list[Extension]:
    """Commands of other packages that can be called: those without a name of our own."""
    return [one for one in installed(COMMANDS) if not one.shipped and one.name not in OWN]


def _place(name: str) -> tuple[str, str]:
    """Module of a command of this package, and the attribute there."""
    where = f'taxinet_ros.cli.{OWN[name]}' if OWN[name] else SHIPPED[COMMANDS][name]
    module, _, attribute = where.partition(':')
    return module, attribute


def command_function(name: str) -> Any:
    """The function of a command of this package, or its group; its module is imported now."""
    module, attribute = _place(name)
    return getattr(importlib.import_module(module), attribute)


def first_sentence(name: str) -> str:
    """The first sentence of a command's own text, out of its module, which is not imported."""
    module, attribute = _place(name)
    path = Path(taxinet_ros.__path__[0], *module.split('.')[1:]).with_suffix('.py')
    source = path.read_text(encoding='utf-8')
    found = re.search(
        rf'^def {attribute}\(.*?\n    """(.+?)(?:"""|\n)'
        rf"|^{attribute} = command_group\(\s*'([^']*?\.)[ ']", source, re.MULTILINE | re.DOTALL,
    )
    return (found[1] or found[2]) if found else ''


def load_command(name: str) -> Any:
    """Import a command and build its parser.

    Raises:
        KeyError: there is no such command.
        UsageError: it is of another package, and cannot be called.
    """
    if name in OWN:
        return _parser(name, command_function(name))
    for extension in added():
        if extension.name == name:
            return load_extension(extension)
    raise KeyError(name)


def load_extension(extension: Extension) -> Any:
    """Import an extension that is a command and build its parser.

    Raises:
        UsageError: it cannot be called, its package is broken, or the name is not its alone.
    """
    if extension.name in OWN and not extension.shipped:
        raise UsageError(
            f'{extension.words}: taxinet itself has a command of this name, which stays the one '
            'that is run'
        )
    find(COMMANDS, extension.name)  # refuses what is no name, and that of two packages
    thing = extension.load()
    if not callable(thing):
        raise UsageError(
            f'{extension.words}: {extension.target} is {type(thing).__name__}; expected a function '
            'or a typer.Typer'
        )
    try:
        return _parser(extension.name, thing)
    except Exception as error:  # whatever typer says of the arguments
        raise extension.failure(error) from error


def _parser(name: str, thing: Any) -> Any:
    """Parser of a function, which is a command, or of an app, which is a group of commands."""
    app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    if isinstance(thing, typer.Typer):
        app.add_typer(thing, name=name)
    else:
        app.command(name, context_settings=_CONTEXT_SETTINGS.get(name))(thing)
    add_examples(app)
    check_commands(app)
    return typer.main.get_group(app).commands[name]


class _Commands(Mapping[str, Any]):
    """Commands by name, each imported when it is asked for."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            self._loaded[name] = load_command(name)
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return name in OWN or any(one.name == name for one in added())

    def __iter__(self) -> Iterator[str]:
        yield from OWN
        yield from dict.fromkeys(one.name for one in added())

    def __len__(self) -> int:
        return len(list(iter(self)))


class Commands(TyperGroup):
    """The group of all commands. Lists and completes their names without importing any."""

    def __init__(self, *words: Any, **named: Any) -> None:
        """Create the group."""
        super().__init__(*words, **named)
        # It acts as the dict that typer declares.
        self.commands = _Commands()  # type: ignore[assignment]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name; None if there is none."""
        if cmd_name not in self.commands:  # not get(): a KeyError of an import is none of ours
            return None
        return self.commands[cmd_name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the sections to the help."""
        width = max(map(len, self.commands))
        for title, lines in _lines().items():
            with formatter.section(title):
                formatter.write_dl([(f'{name:<{width}}', line) for name, line in lines.items()])

    def shell_complete(self, ctx: Any, incomplete: str) -> list[Any]:
        """Names and options that begin so."""
        from typer._click.shell_completion import CompletionItem

        names = [
            CompletionItem(name, help=shorten(line, _ONE_LINE, placeholder='…'))
            for lines in _lines().values() for name, line in lines.items()
            if name.startswith(incomplete)
        ]
        return [*names, *super(TyperGroup, self).shell_complete(ctx, incomplete)]


def _lines() -> dict[str, dict[str, str]]:
    """Names with their lines, by section."""
    lines = {
        title: {name: first_sentence(name) for name in section}
        for title, section in SECTIONS.items()
    }
    others = {one.name: f'Command of {one.distribution} {one.version}.' for one in added()}
    return {**lines, 'Of other packages': others} if others else lines
