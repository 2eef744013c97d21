"""The argument as SVG: shapes of the Goal Structuring Notation, readable on paper and screen.

One band for each system, below one another: its goal with its contexts to the right, the goals that
support it, and their solutions. Relations run at right angles: *SupportedBy* ends in a filled
arrow, *InContextOf* in a hollow one. Equal arguments give equal bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from pathlib import Path

import matplotlib as mpl
from PIL import ImageFont

from taxinet_ros.analysis.report.parts import Theme
from taxinet_ros.analysis.report.pictures import LIGHT
from taxinet_ros.analysis.report.values import clean
from taxinet_ros.extras.evidence.argument import Argument, Kind, Node
from taxinet_ros.extras.evidence.figures import Verdict

_COLUMNS = 6
_CELL, _GAP = 190, 14
_MARGIN = 26
_WIDTH = 2 * _MARGIN + _COLUMNS * _CELL + (_COLUMNS - 1) * _GAP
_LINE, _SIZE, _SMALL = 15, 12, 10.5
_PAD = 9
_LANE = 34
"""Height between rows, in which relations run."""
_MARKS = {
    Verdict.SUPPORTED: '✓ supported', Verdict.REFUTED: '✗ refuted',
    Verdict.UNDETERMINED: '? undetermined',
}
_FAMILY = 'DejaVu Sans, Verdana, sans-serif'
_MOST_LINES = 9
_LONGEST_WORD = 600
"""More letters than there is place for, so that measuring them does not take minutes."""
_LEAST_CIRCLE = 140.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Box:
    """A placed element.

    Attributes:
        node: the element.
        lines: its text, wrapped.
        x, y, width, height: its place [px].
    """

    node: Node
    lines: tuple[str, ...]
    x: float
    y: float
    width: float
    height: float

    @property
    def middle(self) -> float:
        """Horizontal middle."""
        return self.x + self.width / 2

    @property
    def bottom(self) -> float:
        """Lower edge."""
        return self.y + self.height


def argument_svg(argument: Argument, theme: Theme = LIGHT) -> str:
    """Draw an argument.

    Args:
        argument: a sound argument, as :func:`.argument.build_argument` makes.
        theme: its colours.
    """
    layout = _Layout(argument)
    body = [*layout.lines(theme), *(_shape(box, theme) for box in layout.boxes)]
    height = layout.height
    about = 'Argument in Goal Structuring Notation, from the requirement to the results'
    legend = _legend(theme, height - 22)
    return '\n'.join([
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_n(height)}" '
        f'width="{_WIDTH}" height="{_n(height)}" role="img" font-family="{_FAMILY}" '
        f'font-size="{_SIZE}">',
        f'<title>{about}</title>',
        f'<rect width="{_WIDTH}" height="{_n(height)}" fill="{theme.paper}"/>',
        *body, *legend, '</svg>', '',
    ])


def drawing_size(argument: Argument) -> tuple[int, int]:
    """Width and height of its drawing [px]."""
    return _WIDTH, round(_Layout(argument).height)


class _Layout:
    """Places all elements: rows from the top down."""

    def __init__(self, argument: Argument) -> None:
        self._argument = argument
        self.boxes: list[Box] = []
        top = argument.nodes[0]
        strategy = argument.below(top.name)[0]
        y = self._row(top, float(_MARGIN))
        y = self._row(strategy, y + _LANE)
        for system in argument.below(strategy.name):
            y = self._row(system, y + _LANE + 12)
            y = self._parts(argument.below(system.name), y + _LANE)
        self.height = y + 46

    def place(self, name: str) -> Box:
        """The box of an element."""
        return next(box for box in self.boxes if box.node.name == name)

    def _row(self, node: Node, y: float) -> float:
        """An element two columns wide, and its contexts to the right, in rows of four."""
        wide = _CELL * 2 + _GAP
        own = _box(node, _MARGIN + 18, y, wide - 18)
        self.boxes.append(own)
        low, row_y = own.bottom, y
        beside = self._argument.beside(node.name)
        for first in range(0, len(beside), _COLUMNS - 2):
            row = [
                _box(one, _MARGIN + (2 + at) * (_CELL + _GAP), row_y, _CELL)
                for at, one in enumerate(beside[first:first + _COLUMNS - 2])
            ]
            self.boxes += row
            low = max(low, *(box.bottom for box in row))
            row_y = max(box.bottom for box in row) + 24
        return low

    def _parts(self, goals: Sequence[Node], y: float) -> float:
        """Goals side by side, in rows of six, each with its solutions below."""
        low = y
        for first in range(0, len(goals), _COLUMNS):
            y = low if not first else low + _LANE
            row = [
                _box(one, _MARGIN + at * (_CELL + _GAP), y, _CELL)
                for at, one in enumerate(goals[first:first + _COLUMNS])
            ]
            self.boxes += row
            base = max(box.bottom for box in row)
            low = base
            for box in row:
                at = base + _LANE
                for one in self._argument.below(box.node.name):
                    solution = _box(one, box.x, at, _CELL)
                    self.boxes.append(solution)
                    at = solution.bottom + 12
                    low = max(low, solution.bottom)
                if box.node.undeveloped:
                    low = max(low, box.bottom + 22)
        return low

    def lines(self, theme: Theme) -> Iterator[str]:
        """The relations."""
        argument = self._argument
        top = argument.nodes[0]
        strategy = argument.below(top.name)[0]
        yield from self._contexts(top, theme)
        yield from self._contexts(strategy, theme)
        above, below = self.place(top.name), self.place(strategy.name)
        yield _path([(above.middle, above.bottom), (below.middle, below.y)], theme)
        start = self.place(strategy.name)
        for system in argument.below(strategy.name):
            box = self.place(system.name)
            side, turn = _MARGIN + 2.0, start.bottom + 12
            entry = box.y + min(20, box.height / 2)
            yield _path([
                (start.x + 30, start.bottom), (start.x + 30, turn), (side, turn), (side, entry),
                (box.x, entry),
            ], theme)
            yield from self._contexts(system, theme)
            yield from self._support(box, [self.place(one.name) for one in argument.below(
                system.name)], theme)

    def _support(self, box: Box, goals: Sequence[Box], theme: Theme) -> Iterator[str]:
        trunk = box.x + 60  # beside the contexts of the same band
        for goal in goals:
            lane = goal.y - 14
            yield _path([(trunk, box.bottom), (trunk, lane), (goal.middle, lane),
                         (goal.middle, goal.y)], theme)
            for one in self._argument.below(goal.node.name):
                solution = self.place(one.name)
                yield _path([(goal.middle, goal.bottom), (solution.middle, solution.y)], theme)
            if goal.node.undeveloped:
                yield _diamond(goal.middle, goal.bottom, theme)

    def _contexts(self, node: Node, theme: Theme) -> Iterator[str]:
        own = self.place(node.name)
        for one in self._argument.beside(node.name):
            box = self.place(one.name)
            middle = box.y + box.height / 2
            gap = own.x + own.width + _GAP / 2
            if box.y == own.y and box is self.place(self._argument.beside(node.name)[0].name):
                start = min(max(middle, own.y + 8), own.bottom - 8)
                points = [(own.x + own.width, start), (gap, start), (gap, middle), (box.x, middle)]
            else:
                lane, start = box.y - 10, own.y + 8
                points = [(own.x + own.width, start), (gap, start), (gap, lane),
                          (box.middle, lane), (box.middle, box.y)]
            yield _path(points, theme, hollow=True)


def _box(node: Node, x: float, y: float, width: float) -> Box:
    inset = {
        Kind.SOLUTION: 70, Kind.ASSUMPTION: 44, Kind.JUSTIFICATION: 44, Kind.STRATEGY: 34,
    }.get(node.kind, 2 * _PAD)
    lines = _wrapped(node.text, width - inset, _SIZE)
    rows = len(lines) + 1  # the identifier
    if node.kind is Kind.GOAL:
        why = _wrapped(node.why, width - inset, _SMALL)
        rows += 1 + len(why)
    height = rows * _LINE + 2 * _PAD
    if node.kind in (Kind.ASSUMPTION, Kind.JUSTIFICATION):
        height += 2 * _LINE
    if node.kind is Kind.SOLUTION:
        side = max(_LEAST_CIRCLE, rows * _LINE * 1.25 + 4 * _PAD)
        return Box(node=node, lines=lines, x=x + (width - side) / 2, y=y, width=side, height=side)
    return Box(node=node, lines=lines, x=x, y=y, width=width, height=height)


def _escape(text: str) -> str:
    """Text for XML, in which control characters are no text."""
    return escape(clean(text))


@lru_cache(maxsize=8)
def _font(size: float) -> ImageFont.FreeTypeFont:
    """DejaVu Sans, as wide as any usual font, in whole pixels times ten."""
    path = Path(mpl.get_data_path()) / 'fonts' / 'ttf' / 'DejaVuSans.ttf'
    return ImageFont.truetype(str(path), round(size * 10))


def _wrapped(text: str, width: float, size: float) -> tuple[str, ...]:
    """Lines of a text; a word that is too long is cut, a text that is too long ends in ``…``."""
    font = _font(size)

    def fits(words: str) -> bool:
        return font.getlength(words) / 10 <= width

    lines: list[str] = []
    line = ''
    for word in text.split():
        if len(lines) > _MOST_LINES:  # no more are drawn
            break
        word = word[:_LONGEST_WORD]
        while not fits(word):
            cut = _cut(word, fits)
            if line:
                lines.append(line)
                line = ''
            lines.append(f'{word[:cut]}-')
            word = word[cut:]
        if line and not fits(f'{line} {word}'):
            lines.append(line)
            line = word
        else:
            line = f'{line} {word}' if line else word
    lines += [line] if line else []
    if len(lines) > _MOST_LINES:
        return (*lines[:_MOST_LINES - 1], f'{lines[_MOST_LINES - 1].rstrip(".,; ")} …')
    return tuple(lines)


def _cut(word: str, fits: Callable[[str], bool]) -> int:
    """Number of letters of a word that fit with a hyphen, at least 1; found by halving."""
    low, high = 1, len(word)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if fits(f'{word[:middle]}-') else (low, middle)
    return low


def _n(value: float) -> str:
    return f'{value:.1f}'.rstrip('0').rstrip('.')


def _path(points: Sequence[tuple[float, float]], theme: Theme, *, hollow: bool = False) -> str:
    """A line with an arrow at its end: filled, or hollow."""
    (x0, y0), (x, y) = points[-2:]
    across = abs(x - x0) > abs(y - y0)
    back, half = 9.0, 4.5
    if across:
        way = 1 if x > x0 else -1
        end, tips = (x - way * back, y), [(x, y), (x - way * back, y - half),
                                          (x - way * back, y + half)]
    else:
        way = 1 if y > y0 else -1
        end, tips = (x, y - way * back), [(x, y), (x - half, y - way * back),
                                          (x + half, y - way * back)]
    line = ' '.join(f'{_n(px)},{_n(py)}' for px, py in (*points[:-1], end))
    arrow = ' '.join(f'{_n(px)},{_n(py)}' for px, py in tips)
    fill = theme.paper if hollow else theme.ink
    return (
        f'<polyline points="{line}" fill="none" stroke="{theme.ink}" '
        'shape-rendering="crispEdges"/>'
        f'<polygon points="{arrow}" fill="{fill}" stroke="{theme.ink}"/>'
    )


def _diamond(x: float, y: float, theme: Theme) -> str:
    points = ' '.join(f'{_n(px)},{_n(py)}' for px, py in (
        (x, y), (x + 9, y + 9), (x, y + 18), (x - 9, y + 9)
    ))
    return f'<polygon points="{points}" fill="{theme.paper}" stroke="{theme.ink}"/>'


def _shape(box: Box, theme: Theme) -> str:
    node, x, y, width, height = box.node, box.x, box.y, box.width, box.height
    style = f'fill="{theme.paper}" stroke="{theme.ink}" stroke-width="1.3"'
    match node.kind:
        case Kind.SOLUTION:
            shape = (f'<circle cx="{_n(box.middle)}" cy="{_n(y + height / 2)}" '
                     f'r="{_n(width / 2)}" {style}/>')
        case Kind.CONTEXT:
            shape = (f'<rect x="{_n(x)}" y="{_n(y)}" width="{_n(width)}" height="{_n(height)}" '
                     f'rx="{_n(min(height, 60) / 2)}" {style}/>')
        case Kind.ASSUMPTION | Kind.JUSTIFICATION:
            letter = 'A' if node.kind is Kind.ASSUMPTION else 'J'
            shape = (
                f'<ellipse cx="{_n(box.middle)}" cy="{_n(y + height / 2)}" rx="{_n(width / 2)}" '
                f'ry="{_n(height / 2)}" {style}/>'
                f'<text x="{_n(x + width - 8)}" y="{_n(y + height - 2)}" fill="{theme.ink}" '
                f'font-weight="bold">{letter}</text>'
            )
        case Kind.STRATEGY:
            points = ' '.join(f'{_n(px)},{_n(py)}' for px, py in (
                (x + 14, y), (x + width, y), (x + width - 14, y + height), (x, y + height)
            ))
            shape = f'<polygon points="{points}" {style}/>'
        case _:
            shape = (f'<rect x="{_n(x)}" y="{_n(y)}" width="{_n(width)}" height="{_n(height)}" '
                     f'{style}/>')
    told = f'{node.name}: {node.text}' + (f' ({node.why})' if node.why else '')
    return f'<g><title>{_escape(told)}</title>{shape}{"".join(_texts(box, theme))}</g>'


def _texts(box: Box, theme: Theme) -> Iterator[str]:
    node = box.node
    centred = node.kind in (Kind.SOLUTION, Kind.ASSUMPTION, Kind.JUSTIFICATION)
    left = box.x + (24 if node.kind is Kind.STRATEGY else _PAD + 2)
    at = f'x="{_n(box.middle)}" text-anchor="middle"' if centred else f'x="{_n(left)}"'
    rows = len(box.lines) + 1
    y = box.y + _PAD + 11
    if centred:
        y = box.y + (box.height - rows * _LINE) / 2 + 11
    yield f'<text {at} y="{_n(y)}" fill="{theme.ink}" font-weight="bold">{node.name}</text>'
    for line in box.lines:
        y += _LINE
        yield f'<text {at} y="{_n(y)}" fill="{theme.ink}">{_escape(line)}</text>'
    if node.kind is not Kind.GOAL:
        return
    y += _LINE
    colour = {
        Verdict.SUPPORTED: theme.passed, Verdict.REFUTED: theme.failed,
    }.get(node.verdict or Verdict.UNDETERMINED, theme.ink)
    mark = '◇ undeveloped' if node.undeveloped else _MARKS[node.verdict or Verdict.UNDETERMINED]
    yield f'<text {at} y="{_n(y)}" fill="{colour}" font-weight="bold">{mark}</text>'
    for line in _wrapped(node.why, box.width - 2 * _PAD, _SMALL):
        y += _LINE
        yield (
            f'<text {at} y="{_n(y)}" fill="{theme.ink}" font-size="{_SMALL}">{_escape(line)}</text>'
        )


def _legend(theme: Theme, y: float) -> Iterator[str]:
    x = float(_MARGIN)
    yield _path([(x, y), (x + 40, y)], theme)
    yield f'<text x="{_n(x + 48)}" y="{_n(y + 4)}" fill="{theme.ink}">SupportedBy</text>'
    yield _path([(x + 160, y), (x + 200, y)], theme, hollow=True)
    yield f'<text x="{_n(x + 208)}" y="{_n(y + 4)}" fill="{theme.ink}">InContextOf</text>'
    words = (
        'G goal, S strategy, Sn solution, C context, A assumption, J justification; '
        '◇ nothing supports it yet'
    )
    yield f'<text x="{_n(x + 330)}" y="{_n(y + 4)}" fill="{theme.ink}">{words}</text>'
