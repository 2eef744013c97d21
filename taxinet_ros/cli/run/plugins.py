"""``taxinet plugins``: list extensions by name, their packages, and whether they are usable."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from rich.console import Console

from taxinet_ros.cli.commands import load_extension
from taxinet_ros.core.motion.controller import check_controller
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.registry import COMMANDS, SHIPPED, Extension, installed
from taxinet_ros.samplers.registry import SAMPLERS

_USES: Mapping[str, Callable[[str], Any]] = {
    'perceptions': check_perception, 'controllers': check_controller,
    'samplers': SAMPLERS.__getitem__, 'worlds': find_world, 'cameras': find_renderer,
    'requirements': parse_spec,
}
"""Function that finds a name for use, by extension point; commands are loaded."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Listed:
    """An extension and whether it is usable.

    Attributes:
        extension: the extension.
        trouble: why it cannot be used, or ''.
    """

    extension: Extension
    trouble: str


def show_plugins(name: str | None, *, as_json: bool) -> int:
    """Print the names of all extension points, or the extensions of one name.

    Returns:
        Exit code: 0; with a name, 2 if an extension of that name cannot be used.

    Raises:
        UsageError: no extension has the name.
    """
    found = [
        Listed(extension=one, trouble=_trouble(one))
        for kind in SHIPPED for one in installed(kind) if name in (None, one.name)
    ]
    if not found:
        raise UsageError(f'plugins: nothing is called {name!r}; taxinet plugins lists all names')
    if as_json:
        print(json.dumps([
            {**asdict(one.extension), 'shipped': one.extension.shipped, 'usable': not one.trouble,
             'trouble': one.trouble} for one in found
        ], indent=2))
    else:
        _print(found)
    broken = any(one.trouble for one in found)
    return ExitCode.USAGE if name is not None and broken else ExitCode.OK


def _trouble(one: Extension) -> str:
    try:
        if one.kind == COMMANDS:
            load_extension(one)
        else:
            _USES[one.kind](one.name)
    except UsageError as error:
        return str(error)
    return ''


def _print(found: list[Listed]) -> None:
    console = Console(highlight=False)
    width = max(len(one.extension.name) for one in found)
    whose = max(len(_whose(one.extension)) for one in found)
    kind = ''
    for one in found:
        if one.extension.kind != kind:
            kind = one.extension.kind
            console.print(kind)
        line = f'  {one.extension.name:<{width}}  {_whose(one.extension):<{whose}}  '
        console.print(f'{line}{one.extension.target}', soft_wrap=True, markup=False)
        if one.trouble:
            console.print(f'    cannot be used: {one.trouble}', soft_wrap=True, markup=False)


def _whose(one: Extension) -> str:
    return 'shipped' if one.shipped else f'{one.distribution} {one.version}'
