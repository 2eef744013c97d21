"""``taxinet keys``: the keys of a scenario, which ``--set`` and Scenic programs take."""

from __future__ import annotations

import re
from typing import Annotated, Any

import typer

from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import UsageError, near_miss


def keys(
    word: Annotated[
        str, typer.Argument(metavar='[WORD]', help='only those with this in their line, such as '
                            'wind')
    ] = '',
    as_json: JsonOption = False,
) -> None:
    """List what --set takes: keys of a scenario, what they may be, and their defaults.

    Ranges are those at the paper's runway, and adapt to place and track.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from taxinet_ros.core.scenario import Scenario
    from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS

    plain = Scenario()
    lines: list[dict[str, Any]] = [
        {
            'key': field.key, 'may_be': field.allowed,
            'default': field.as_typed(getattr(plain, field.attribute)), 'what': field.title,
            'varies': field.varies,
        }
        for field in SCENARIO_FIELDS
    ]
    found = [one for one in lines if word.lower() in ' '.join(map(str, one.values())).lower()]
    if not found:
        known = re.findall(r'[\w-]+', ' '.join(f'{one["key"]} {one["what"]}' for one in lines))
        near = near_miss(word.lower(), known)
        raise UsageError(f'keys: none has {word!r} in its line{near}; taxinet keys lists all')
    if as_json:
        print_json(found)
        return
    table = Table('key', 'may be', 'default', 'what', box=SIMPLE_HEAD, show_edge=False)
    for one in found:
        mark = ' ~' if one['varies'] else ''
        table.add_row(one['key'], one['may_be'], one['default'], f'{one["what"]}{mark}')
    console = line_console(width=120)
    console.print(table, soft_wrap=False)
    if any(one['varies'] for one in found):
        console.print('~ may change within a run: --set KEY=VALUE --set KEY@SECONDS=VALUE')
