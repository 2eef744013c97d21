"""A report as a self-contained HTML file that needs no network and no other files.

Injected code cannot run in it: text is escaped, data are JSON that no browser executes, and a
content security policy admits only our own style and script, by their digests.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import quote

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from taxinet_ros.analysis.report.parts import Report, Section
from taxinet_ros.analysis.report.pictures import DARK, LIGHT, view_picture, write_pictures
from taxinet_ros.analysis.report.table import run_link, view_table
from taxinet_ros.analysis.report.values import clean, cleaned, data_block
from taxinet_ros.analysis.report.viewer import RunView, read_run_view
from taxinet_ros.analysis.report.worst import rho_words, view_worst
from taxinet_ros.bag.errors import BagError
from taxinet_ros.core.provenance import provenance, words
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.pages import write_index
from taxinet_ros.trials.record.facts import record_beside

_ASSETS = Path(__file__).parent / 'assets'
_STYLES = ('page.css', 'table.css', 'viewer.css')
_SCRIPTS = (
    'values.js', 'theme.js', 'table.js', 'player.js', 'camera.js', 'runway_map.js', 'plots.js',
    'viewer.js', 'page.js',
)


def write_report(
    report: Report, page: Path, *, on_progress: Callable[[str], None] = lambda words: None
) -> list[Path]:
    """Write a report as a page, and its pictures beside it; return their paths.

    Arguments and errors as of :func:`write_report_page`.
    """
    pictures = write_pictures(report, page.parent, on_progress)
    drawn = {path.stem: path.read_bytes() for path in pictures}
    write_report_page(report, page, on_progress=on_progress, drawn=drawn)
    return pictures


def write_report_page(
    report: Report, path: Path, *, on_progress: Callable[[str], None] = lambda words: None,
    drawn: Mapping[str, bytes] = {},
) -> None:
    """Write a report as a page; the same report gives the same bytes.

    If a run's bag cannot be read, the page shows the reason instead of a viewer. A page in a
    campaign's folder is put on the list there (:func:`.write_index`).

    Args:
        report: the report.
        path: HTML file to write, in an existing folder.
        on_progress: called with a description of the next step.
        drawn: pictures by name that are drawn already, as PNG for light pages.

    Raises:
        OSError: it cannot be written.
        ValueError: a table is inconsistent.
    """
    html = _html(report, on_progress, drawn)
    on_progress(f'writing {path.name}')
    write_atomically(path, html)
    if (campaign := record_beside(path)) is not None:
        write_index(campaign)


def _html(
    report: Report, on_progress: Callable[[str], None], drawn: Mapping[str, bytes]
) -> str:
    views, troubles = _read_runs(report, on_progress)
    style = _theme_style() + _joined(_STYLES)
    script = f"(() => {{\n'use strict';\n{_joined(_SCRIPTS)}}})();\n"
    return _environment().get_template('page.html').render(
        report=report, views=views, troubles=troubles, run_link=run_link, page_link=page_link,
        worst=_worst(report, views), rho={clean(run): rho_words(rho)
                                         for run, rho in report.rho.items()},
        made_on=words(provenance()),
        sections=[_section(section, views, on_progress, drawn) for section in report.sections],
        policy=_policy(style, script), style=Markup(style), script=Markup(script),
        run_data=[data_block(view.data()) for view in views.values()],
        ground_data=data_block(_grounds(views)), run_ids=data_block(list(views)),
    )


def _worst(report: Report, views: Mapping[str, RunView]) -> dict[str, Any] | None:
    """The run of the first screen; None if there is none, or it has no viewer."""
    view = views.get(clean(report.worst))
    if view is None or not len(view.t_s):
        return None
    return view_worst(view, report.rho.get(report.worst))


def page_link(path: str) -> str:
    """Address of another file, from its path relative to the page; never of another host."""
    return quote(f'./{clean(path)}', safe='/')


def _environment() -> Environment:
    """Jinja with the page's templates; everything is escaped, an unknown name is an error."""
    return Environment(
        loader=FileSystemLoader(_ASSETS), autoescape=True, undefined=StrictUndefined,
        finalize=cleaned, trim_blocks=True, lstrip_blocks=True,
    )


def _read_runs(
    report: Report, on_progress: Callable[[str], None]
) -> tuple[dict[str, RunView], dict[str, str]]:
    """The runs that have a viewer, and the reasons why others have none."""
    views: dict[str, RunView] = {}
    troubles: dict[str, str] = {}
    for number, (name, bag) in enumerate(report.runs.items(), start=1):
        run_id = clean(name)
        on_progress(f'run {number} of {len(report.runs)}: {run_id}')
        try:
            views.setdefault(run_id, read_run_view(run_id, bag))
        except (BagError, UsageError, InfraError, OSError) as error:
            troubles[run_id] = ' '.join(str(error).split())
    return views, troubles


def _section(
    section: Section, views: Mapping[str, RunView], on_progress: Callable[[str], None],
    drawn: Mapping[str, bytes],
) -> dict[str, Any]:
    pictures = []
    for picture in section.pictures:
        on_progress(f'picture {picture.name}')
        pictures.append(view_picture(picture, drawn.get(picture.name)))
    tables = [view_table(table, views.keys()) for table in section.tables]
    return {'section': section, 'pictures': pictures, 'tables': tables}


def _grounds(views: Mapping[str, RunView]) -> dict[str, Any]:
    """The runways of the runs, each distinct one once."""
    named = {view.ground_name: view for view in views.values()}
    return {name: named[name].ground_shapes() for name in sorted(named)}


def _joined(names: tuple[str, ...]) -> str:
    """Text of some assets, one after the other."""
    return '\n'.join((_ASSETS / name).read_text(encoding='utf-8') for name in names)


def _theme_style() -> str:
    """The colours shared by page and pictures, as CSS properties."""
    pairs = {
        name: (getattr(LIGHT, name), getattr(DARK, name))
        for name in ('ink', 'faint', 'paper', 'passed', 'failed')
    }
    lines = [f'  --{name}: light-dark({light}, {dark});' for name, (light, dark) in pairs.items()]
    return '\n'.join([':root {', *lines, '}', ''])


def _policy(style: str, script: str) -> str:
    """Content security policy that admits this style and script only."""
    return '; '.join([
        "default-src 'none'", 'img-src data:', f"style-src '{_digest(style)}'",
        f"script-src '{_digest(script)}'", "base-uri 'none'", "form-action 'none'",
    ])


def _digest(text: str) -> str:
    return 'sha256-' + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')
