"""The live page of a running campaign: its values as JSON, and the page that shows them.

The page is made of the same parts as a report and asks for nothing but its own values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

from markupsafe import Markup

from taxinet_ros.analysis.report.page import environment, joined, page_policy, theme_style
from taxinet_ros.analysis.report.values import plain_values
from taxinet_ros.campaign.rates import Planned, ProgramRate, failure_rate, off_runway_rate
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.summary import scene_words
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS, Kind
from taxinet_ros.core.verdict.outcome import Outcome

MOST_ROWS = 3000
"""Rows of one answer: the latest; a page that is opened late shows no older ones on its map."""
_NUMBERS = tuple(field for field in SCENARIO_FIELDS if field.kind is Kind.NUMBER)
_STYLES, _SCRIPTS = ('page.css', 'table.css', 'live.css'), ('values.js', 'theme.js', 'live.js')


def live_page(title: str, facts: dict[str, str], data: str) -> tuple[str, str]:
    """The page and its content security policy.

    Args:
        title: title of the page.
        facts: what is searched, shown small.
        data: address of the values, relative to the page.
    """
    style, script = theme_style() + joined(_STYLES), (
        f"(() => {{\n'use strict';\n{joined(_SCRIPTS)}}})();\n")
    policy = page_policy(style, script, "connect-src 'self'")
    html = environment().get_template('live.html').render(
        title=title, facts=facts, data=data, policy=policy, style=Markup(style),
        script=Markup(script),
    )
    return html, policy


def live_values(
    rows: Sequence[RunRow], planned: Planned, *, runs: int, after: int, ended: str = ''
) -> dict[str, Any]:
    """What the page shows, as JSON values.

    Args:
        rows: the runs so far, in the order of their ends.
        planned: runs fixed before the first one; a viewer may stop at any time, so intervals have
            to be valid at every look, as in the terminal.
        runs: number of runs asked for.
        after: number of rows that the page already has.
        ended: how the campaign ended, or '' while it runs.

    Returns:
        Counts and rates of all rows; ``rows`` after those that the page has, ``first`` is the
        number of the first of them. Robustness is None where it is not known.
    """
    order = planned if isinstance(planned, range) else range(planned or 0)
    any_time = range(order.start, 0, order.step)
    judged = [row for row in rows if row.outcome.judged]
    off = off_runway_rate(rows, any_time)
    first = max(0, min(after, len(rows)), len(rows) - MOST_ROWS)
    known = [row.headline[1] for row in judged if row.headline]
    return plain_values({
        'done': len(rows), 'runs': runs, 'ended': ended, 'judged': len(judged),
        'failed': sum(row.outcome is Outcome.FAIL for row in judged),
        'without_verdict': len(rows) - len(judged),
        'failing': _rate_words(failure_rate(rows, any_time)),
        'off_runway': '' if off is None else _rate_words(off),
        'lowest': min(known, default=math.nan),
        'first': first, 'rows': [_row(row) for row in rows[first:]],
        'fields': [
            {'key': field.key, 'title': field.title, 'unit': field.unit} for field in _NUMBERS
        ],
    })


def _rate_words(found: ProgramRate) -> str:
    if not found.runs:
        return ''
    if found.rate is None:
        return found.why_not
    value, low, high = (100 * part for part in found.rate)
    return f'{value:.1f} % ({low:.1f}–{high:.1f} %)'


def _row(row: RunRow) -> dict[str, Any]:
    headline = row.headline
    scene = row.scene if row.outcome.judged else {}
    return {
        'id': row.run_id, 'index': row.index, 'outcome': row.outcome.value,
        'rho': None if headline is None else headline[1],
        'scene': _scene(row), 'detail': '' if row.outcome.judged else row.detail,
        'values': [
            None if (value := scene.get(field.key)) is None else round(float(value), 4)
            for field in _NUMBERS
        ],
    }


def _scene(row: RunRow) -> str:
    """The scene in one line, with the signs of the reports."""
    words = ' '.join(scene_words(row).split()).replace(' deg', '°')
    return re.sub(r'(?<!\S)-(?=[0-9])', '−', words)
