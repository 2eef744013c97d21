"""The parts of a report: sections, tables, and pictures with their theme and style of axes.

An analysis answers in these values; whoever draws or writes decides on the form.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

Cell = str | int | float | bool | None
"""A table's cell; None and NaN stand for what is not known."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Theme:
    """Colours of a drawing, for a light or a dark page.

    Attributes:
        ink: of text, axes and ticks.
        faint: of grids and of what stands behind.
        paper: of the ground.
        passed, failed: of runs that satisfied their formula, or did not.
        others: of further networks or arms, in turn.
    """

    ink: str
    faint: str
    paper: str
    passed: str
    failed: str
    others: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Picture:
    """A drawing that is made when it is wanted.

    Attributes:
        name: of its file, without a suffix; unique within a report.
        title: heads it.
        caption: what it shows and what to see in it, in one or two sentences.
        draw: puts it on an empty figure, in a theme's colours; equal each time.
        size_in: width and height of the figure [inch].
    """

    name: str
    title: str
    caption: str
    draw: Callable[[Figure, Theme], None]
    size_in: tuple[float, float] = (7.0, 3.6)


@dataclass(frozen=True, kw_only=True, slots=True)
class Column:
    """A column of a table.

    Attributes:
        name: as in JSON and files, the unit included, such as ``rain_percent``.
        title: for people, such as ``rain [%]``.
        decimals: digits after the point for numbers; None for text and whole numbers.
    """

    name: str
    title: str
    decimals: int | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """Rows of values.

    Attributes:
        name: of its file, without a suffix; unique within a report.
        title, caption: as with a picture.
        columns: what the cells of a row are, in order.
        rows: the cells.
        run_id_column: the column that names runs, so that a page can link to their viewers.
    """

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    run_id_column: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Section:
    """A heading with what belongs below it.

    Attributes:
        name: unique within the report, for links.
        heading: for people.
        sentences: paragraphs of plain text.
        pictures, tables: in the order in which they are shown.
    """

    name: str
    heading: str
    sentences: tuple[str, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """An analysis of a campaign, for people.

    Attributes:
        title: such as ``s_falsif, 4,000 runs of original``.
        facts: what was run, by what: shown small below the title.
        summary: the findings in words, the most important first.
        sections: the evidence.
        runs: folders of runs to look at step by step, by run id, the worst first.
    """

    title: str
    facts: Mapping[str, str]
    summary: tuple[str, ...]
    sections: tuple[Section, ...]
    runs: Mapping[str, Path] = field(default_factory=dict)


def style_axes(axes: Axes, *, grid: str = 'both') -> None:
    """A grid behind the drawing, and no frame where no scale is."""
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)
    if grid != 'none':
        axes.grid(visible=True, axis='x' if grid == 'x' else 'y' if grid == 'y' else 'both',
                  linewidth=0.6)
    axes.set_axisbelow(True)
