"""Parts of a report: sections, tables, and pictures with their theme and axes style.

An analysis returns these values; their presentation is up to the writer of a report.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Cell = str | int | float | bool | None
"""A table's cell; None and NaN mean unknown."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Theme:
    """Colours of a drawing, for a light or a dark page.

    Attributes:
        ink: colour of text, axes and ticks.
        faint: colour of grids and background elements.
        paper: background colour.
        passed, failed: colours of runs that satisfied their formula, or did not.
        others: colours of further networks or arms, in turn.
    """

    ink: str
    faint: str
    paper: str
    passed: str
    failed: str
    others: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Picture:
    """A picture that is drawn on demand.

    Attributes:
        name: file name without a suffix, unique within a report.
        title: title above it.
        caption: explanation in one or two sentences.
        draw: draws it on an empty figure in a theme's colours; deterministic.
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
        name: name in JSON and files, including the unit, such as ``rain_percent``.
        title: display name, such as ``rain [%]``.
        decimals: number of decimals; None for text and integers.
        on_page: whether a page shows it; files have all columns.
    """

    name: str
    title: str
    decimals: int | None = None
    on_page: bool = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Table:
    """A table of a report.

    Attributes:
        name: file name without a suffix, unique within a report.
        title, caption: see :class:`Picture`.
        columns: the columns in order.
        rows: the cells.
        run_id_column: column with run ids, which a page links to their viewers.
    """

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    run_id_column: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Link:
    """A link to another page or file.

    Attributes:
        words: display text.
        path: path relative to the page's folder, with forward slashes.
    """

    words: str
    path: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Section:
    """A heading with its content.

    Attributes:
        name: unique name within the report, for links.
        heading: display text.
        sentences: paragraphs of plain text.
        commands: shell commands, below the sentences.
        links: other pages, below the commands.
        pictures, tables: in display order.
    """

    name: str
    heading: str
    sentences: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()
    links: tuple[Link, ...] = ()
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """A report on an analysis.

    Attributes:
        title: title, such as ``s_falsif, 4,000 runs of original``.
        facts: facts of the campaign, shown small below the title.
        summary: sentences on the findings, the most important first.
        sections: the evidence.
        runs: folders of runs to inspect step by step, by run id, the worst first.
        worst: the one of them whose frame and path are shown on the first screen; '' for none.
        worst_words: what that run is called.
        rho: robustness of runs, by run id, shown in their list.
        made_on: machine and versions that the evidence comes from, at the end of the page.
    """

    title: str
    facts: Mapping[str, str]
    summary: tuple[str, ...]
    sections: tuple[Section, ...]
    runs: Mapping[str, Path] = field(default_factory=dict)
    worst: str = ''
    worst_words: str = 'The worst run'
    rho: Mapping[str, float] = field(default_factory=dict)
    made_on: str = ''

    @property
    def sentences(self) -> tuple[str, ...]:
        """All sentences, those of the summary first."""
        return (*self.summary, *(
            sentence for section in self.sections for sentence in section.sentences))


def style_axes(axes: Axes, *, grid: str = 'both') -> None:
    """Put a grid behind the plot, and remove the frame at sides without a scale."""
    for side in ('top', 'right'):
        axes.spines[side].set_visible(False)
    if grid != 'none':
        axes.grid(visible=True, axis='x' if grid == 'x' else 'y' if grid == 'y' else 'both',
                  linewidth=0.6)
    axes.set_axisbelow(True)
