"""``taxinet plugins``: list extensions by name, their packages, and whether they are usable."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.commands import load_extension
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.registry import COMMANDS, SHIPPED, Extension, installed


def plugins(
    name: Annotated[
        str | None, typer.Argument(metavar='[NAME]', help='only what stands behind this name')
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """List perceptions, controllers, samplers, worlds, commands and more by name.

    Those that are shipped and those of installed packages, with the package's version and where
    in it each is; also those that cannot be used, with the reason. Exit code 0; with a NAME, 2
    where it cannot be used.
    """
    found = [one for kind in SHIPPED for one in installed(kind) if name in (None, one.name)]
    if not found:
        raise UsageError(f'plugins: nothing is called {name!r}; taxinet plugins lists all names')
    listed = [(one, _trouble(one)) for one in found]
    if as_json:
        print(json.dumps([
            {**asdict(one), 'shipped': one.shipped, 'usable': not trouble, 'trouble': trouble}
            for one, trouble in listed
        ], indent=2))
    else:
        _print(listed)
    broken = any(trouble for _, trouble in listed)
    return ExitCode.USAGE if name is not None and broken else ExitCode.OK


def _trouble(one: Extension) -> str:
    """Why an extension cannot be used, or ''."""
    from taxinet_ros.core.motion.controller import check_controller
    from taxinet_ros.core.mtl import parse_spec
    from taxinet_ros.core.perception.perception import check_perception
    from taxinet_ros.core.renderer import find_renderer
    from taxinet_ros.core.world import find_world
    from taxinet_ros.samplers.registry import SAMPLERS

    uses: Mapping[str, Callable[[str], object]] = {
        'perceptions': check_perception, 'controllers': check_controller,
        'samplers': SAMPLERS.__getitem__, 'worlds': find_world, 'cameras': find_renderer,
        'requirements': parse_spec,
    }
    try:
        if one.kind == COMMANDS:
            load_extension(one)
        else:
            uses[one.kind](one.name)
    except UsageError as error:
        return str(error)
    return ''


def _print(listed: Sequence[tuple[Extension, str]]) -> None:
    console = Console(emoji=False, highlight=False)
    width = max(len(one.name) for one, _ in listed)
    whose = max(len(_whose(one)) for one, _ in listed)
    kind = ''
    for one, trouble in listed:
        if one.kind != kind:
            kind = one.kind
            console.print(kind)
        line = f'  {one.name:<{width}}  {_whose(one):<{whose}}  '
        console.print(f'{line}{one.target}', soft_wrap=True, markup=False)
        if trouble:
            console.print(f'    cannot be used: {trouble}', soft_wrap=True, markup=False)


def _whose(one: Extension) -> str:
    return 'shipped' if one.shipped else f'{one.distribution} {one.version}'
