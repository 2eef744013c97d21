"""All commands: their names in sections, where they are, and what ``taxinet --help`` says of each.

Only the module of the command that is called is imported. Commands of :mod:`taxinet_ros.registry`,
of shipped extras and of other packages, are called in the same way.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator, Mapping
from textwrap import shorten
from typing import Any

import typer
from typer.core import TyperGroup

from taxinet_ros.cli.checked import check_commands
from taxinet_ros.cli.help import add_examples
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import COMMANDS, SHIPPED, Extension, find, installed

SECTIONS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    'Run scenes': {
        'demo': ('run.demo:demo', 'Run ten scenes with both networks and with ground truth.'),
        'run': ('run.run:run', "Run a Scenic program's scenes through the graph."),
        'up': (
            'run.up:up',
            'Start every node except the sampler in its own process and keep them running.',
        ),
        'node': ('run.node:node', 'Start one node, as `ros2 run taxinet_ros NAME` does.'),
        'check-node': (
            'run.check_node:check_node', 'Test your own node against the lockstep protocol.',
        ),
    },
    'Search for failures': {
        'falsify': ('run.falsify:falsify', 'Search a Scenic program for violating scenes.'),
        'estimate': (
            'run.estimate:estimate',
            'Estimate the probability of rare failures, down to one in a hundred thousand.',
        ),
    },
    'Find the causes': {
        'why': ('study.why:why', 'Find out why a campaign or a run failed, and what to do.'),
        'analyze': (
            'analysis.analyze:analyze',
            "Find the causes of a campaign's failures, and write a report.",
        ),
        'localize': (
            'analysis.localize:localize', 'Find which part causes failures: network or controller.',
        ),
        'explain': ('analysis.explain:explain', 'Explain why the network failed in one run.'),
        'shrink': (
            'run.shrink:shrink', 'Shrink a failed run to the nearest scenario that still fails.',
        ),
        'fork': (
            'analysis.fork:fork',
            'Repeat a recorded run up to a moment, and go on in a changed world.',
        ),
        'experiment': (
            'run.experiment:experiment',
            'Confirm a cause by running the same scenes with and without it.',
        ),
    },
    'Judge': {
        'check': (
            'analysis.check:check',
            'Drive networks through 50 fixed scenes, as a quick check before a commit.',
        ),
        'plan': (
            'analysis.plan:plan',
            'Plan how many runs a claim takes, from the start or after those there are.',
        ),
        'gate': ('analysis.gate:gate', 'Check a campaign against acceptance thresholds.'),
        'odd': (
            'analysis.odd:odd_app',
            'Operational design domains (ODD), and what campaigns cover of one.',
        ),
        'forecast': ('', 'Lower bounds on the final robustness of runs in progress.'),
        'compare': (
            'analysis.compare:compare',
            'Compare two networks on the same scenes: what got better, what got worse, and why.',
        ),
        'bisect': (
            'analysis.bisect:bisect',
            'Find which of several networks in order broke which scenes.',
        ),
        'monitor': (
            'analysis.monitor:monitor',
            'Judge recorded runs by their own requirements or by new ones.',
        ),
        'assure': (
            '', 'Calibrate run-time monitors, and judge them in the loop (run them: --monitor).',
        ),
        'live-monitor': ('', 'Evaluate formulas on topics of any robot as messages arrive.'),
        'evidence': ('', 'Write evidence toward a requirement, all by hash, and verify it.'),
        'spec': (
            'analysis.spec:spec',
            'Show how requirements are parsed, and warn of likely mistakes.',
        ),
        'mine': (
            'analysis.mine:mine',
            'Find the tightest parameters with which a formula holds for a share of the runs.',
        ),
        'evaluate': ('training.evaluate:evaluate', "Measure a network's errors on single frames."),
        'score': (
            'analysis.score:score',
            'Score networks on recordings: errors against where the aircraft really was.',
        ),
    },
    'Train': {
        'dataset': ('training.dataset:dataset', 'Render labelled training images of scenes.'),
        'train': (
            'training.train:train', 'Train TaxiNet on rendered scenes or labelled images.',
        ),
        'network': (
            'training.foreign_network:network_app',
            'Networks of others: convert them, and see what they see.',
        ),
        'improve': (
            'study.improve:improve',
            'Improve a network in rounds: falsify, cluster failures, retrain, evaluate, keep if '
            'better.',
        ),
        'tune': (
            '',
            'Tune the steering law: search gains that maximise the worst-case robustness over '
            'scenes.',
        ),
        'case-study': (
            'study.case_study:case_study',
            "Run the paper's case study: falsify, debug, retrain, learn, report.",
        ),
    },
    'Worlds and cameras': {
        'camera': (
            'training.camera:camera_app',
            'Describe cameras, and render their frames.',
        ),
        'place': ('run.place:place', 'Describe a place, and draw it from above, or list all.'),
        'aircraft': (
            'training.aircraft:aircraft',
            'Load an aircraft, measure it, say what is wrong, and draw it, or list all.',
        ),
        'flightgear': ('', 'FlightGear as a camera: start it, and see whether it works.'),
        'xplane': ('', 'X-Plane as camera and as world.'),
    },
    'Recordings and tools': {
        'bag': ('bag.commands:bag_app', 'Inspect, check, repair and export bags.'),
        'doctor': (
            'doctor:doctor', 'Check this machine, or every file in a results folder.',
        ),
        'setup-messages': (
            'messages:setup_messages',
            'Build the ROS 2 messages into this virtual environment, once after pip install.',
        ),
        'plugins': (
            'run.plugins:plugins',
            'List perceptions, controllers, samplers, worlds, commands and more by name.',
        ),
        'bench': (
            'bench.commands:bench',
            'Benchmark camera, closed loop and graph on one core.',
        ),
    },
}
"""Sections in the order of the workflow, and their commands by name: the module below
``taxinet_ros.cli`` and the attribute ('' for a shipped extra, which the registry knows), and the
line of the list, which is the first sentence of the command's own text."""

OWN = {name: listed for section in SECTIONS.values() for name, listed in section.items()}
"""Commands of this package by name. No other package can have the name of one."""

_PASSED_ON = {'ignore_unknown_options': True, 'allow_extra_args': True}
_ONE_LINE = 45
"""Characters of a description beside a completion: shells take a second line for names."""
_CONTEXT_SETTINGS = {'node': _PASSED_ON, 'live-monitor': _PASSED_ON}


def added() -> list[Extension]:
    """Commands of other packages that can be called: those without a name of our own."""
    return [one for one in installed(COMMANDS) if not one.shipped and one.name not in OWN]


def command_function(name: str) -> Any:
    """The function of a command of this package, or its group; its module is imported now."""
    target = OWN[name][0]
    where = f'taxinet_ros.cli.{target}' if target else SHIPPED[COMMANDS][name]
    module, _, attribute = where.partition(':')
    return getattr(importlib.import_module(module), attribute)


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
        title: {name: line for name, (_, line) in section.items()}
        for title, section in SECTIONS.items()
    }
    others = {one.name: f'Command of {one.distribution} {one.version}.' for one in added()}
    return {**lines, 'Of other packages': others} if others else lines
