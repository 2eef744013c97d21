"""Write a learned distribution as a Scenic program that draws from it.

The text of the searched program is kept with its comments and requirements; only the calls that
make the choices are replaced, as in Figure 8 of the paper, derived from S_falsif::

    Range(0, 2000)   ->   Options({Range(0, 200): 0.05, …, Range(1400, 1600): 0.79})
    Uniform(*KINDS)  ->   Options({'clear': 0.6, 'cirrus': 0.4})
    Normal(0, 5)     ->   Options({TruncatedNormal(0, 5, float('-inf'), -6.4): 0.3, …})
    Range(0, r)      ->   Options({Range(0, (0) + 0.1 * ((r) - (0))): 0.2, …})
"""

from __future__ import annotations

import ast
import itertools
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taxinet_ros.errors import UsageError
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file
from taxinet_ros.scenes.search_space import (
    Choice,
    Law,
    Piece,
    Place,
    SearchSpace,
    standard_values,
)

_WIDTH = 100
_CALL = re.compile(
    r'(Range|Uniform|Options|Discrete|DiscreteRange|Normal|TruncatedNormal'
    r'|Verifai(Range|Options|DiscreteRange))\s*\('
)
_DOCSTRING = re.compile(r'\A(?:[ \t]*(?:#[^\n]*)?\n)*("""|\'\'\')(.*?)\1[ \t]*\n?', re.DOTALL)


def learned_program(
    program: Path, space: SearchSpace, probabilities: Mapping[str, Sequence[float]], origin: str
) -> tuple[str, tuple[str, ...]]:
    """Text of a program that draws each choice with the given probabilities.

    Args:
        program: the program that was searched.
        space: its search space, from :meth:`~.scene_source.SceneSource.search_space`.
        probabilities: by name of a dimension, one number of 0 or more for each of its bins
            (categories, or equal slices of the prior); they need not add up to 1. Choices without
            probabilities are not changed.
        origin: origin of the probabilities, for the header: one or more sentences.

    Returns:
        The text, and one line for each choice left unchanged with the reason. The text compiles
        beside all that the program runs (:func:`.write_program`).

    Raises:
        UsageError: no choice can be rewritten, or the probabilities do not match; one line with
            the reason.
    """
    try:
        source = read_file(program, MAX_TEXT_BYTES).decode('utf-8-sig')  # keeps its line ends
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f'{program}: cannot be read: {error}') from error
    text = _Text(program=program.resolve(), source=source)
    unknown = set(probabilities) - {choice.dimension.name for choice in space.choices}
    if unknown:
        raise UsageError(f'{program.name}: has no choice named {sorted(unknown)[0]}')
    made = Counter(choice.place for choice in space.choices)
    edits: list[_Edit] = []
    left: list[str] = []
    for choice in space.choices:
        if choice.dimension.name not in probabilities:
            continue
        weights = text.weights(choice, probabilities)
        try:
            text.refuse_resampled(choice, space)
            edit = text.edit(choice, weights, shared=made[choice.place] > 1)
            text.rewrite(edit.start, edit.end, [edit])
        except UsageError as error:
            left.append(str(error))
        else:
            edits.append(edit)
    if left and not edits:
        raise UsageError(left[0])
    docstring = _DOCSTRING.match(source)
    start = docstring.end() if docstring else 0
    if left:
        origin = '\n'.join([origin.rstrip(), '', 'Left as the program has them:', *left])
    return _head(program, source, origin) + text.rewrite(start, len(source), edits), tuple(left)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Edit:
    """The span of source text that makes a choice, and its replacement."""

    start: int
    end: int
    choice: Choice
    weights: tuple[float, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Text:
    """The source of a program, with the checks for rewriting it."""

    program: Path
    source: str

    def weights(
        self, choice: Choice, probabilities: Mapping[str, Sequence[float]]
    ) -> tuple[float, ...]:
        """The probabilities of a choice's bins, normalised to 1."""
        name = choice.dimension.name
        weights = tuple(float(weight) for weight in probabilities[name])
        bins = len(choice.dimension.prior)
        if len(weights) != bins:
            raise self._refusal(f'{name} has {bins} bins, got {len(weights)} probabilities')
        if not all(math.isfinite(weight) and weight >= 0 for weight in weights) or not sum(weights):
            raise self._refusal(f'{name}: probabilities have to be 0 or more, and one above 0')
        total = math.fsum(weights)
        return tuple(weight / total for weight in weights)

    def refuse_resampled(self, choice: Choice, space: SearchSpace) -> None:
        """Refuse ``resample(x)``: it would draw from the replacement of ``x``."""
        for other in space.choices:
            place = other.place
            if place is None or other is choice or Path(place.file).resolve() != self.program:
                continue
            start = _line_starts(self.source)[place.line - 1] + place.column
            same = (other.law, other.pieces, other.dimension.weights) == (
                choice.law, choice.pieces, choice.dimension.weights)
            if same and self.source.startswith('resample', start):
                name = choice.dimension.name
                raise self._refusal(f'{name} is drawn again by resample', choice.place)

    def edit(self, choice: Choice, weights: tuple[float, ...], *, shared: bool) -> _Edit:
        """The edit of the call that makes a choice."""
        start, end = self._span(choice)
        if shared:
            name = choice.dimension.name
            raise self._refusal(f'{name} is not the only choice made there', choice.place)
        return _Edit(start=start, end=end, choice=choice, weights=weights)

    def rewrite(self, start: int, end: int, edits: Sequence[_Edit]) -> str:
        """The text from ``start`` to ``end`` with all edits within it applied."""
        parts, at = [], start
        for edit in sorted(edits, key=lambda edit: (edit.start, -edit.end)):
            if at <= edit.start and edit.end <= end:
                parts += [self.source[at:edit.start], self._call(edit, edits)]
                at = edit.end
        return ''.join([*parts, self.source[at:end]])

    def _call(self, edit: _Edit, edits: Sequence[_Edit]) -> str:
        """The new call; choices that are made inside it are rewritten too."""
        items = [f'{text}: {weight:.12g}' for text, weight in self._weighted(edit, edits)]
        line_start = self.source.rfind('\n', 0, edit.start) + 1
        line = self.source[line_start:edit.start]
        call = f'Options({{{", ".join(items)}}})'
        if '\n' not in call and len(line + call) <= _WIDTH:
            return call
        indent = line[:len(line) - len(line.lstrip())]
        body = ''.join(f'{indent}    {item},\n' for item in items)
        return f'Options({{\n{body}{indent}}})'

    def _weighted(self, edit: _Edit, edits: Sequence[_Edit]) -> list[tuple[str, float]]:
        choice = edit.choice
        if choice.pieces:
            bins = zip(itertools.pairwise(choice.dimension.edges), edit.weights, strict=True)
            items = [item for (start, end), weight in bins
                     for item in _ranges(choice.pieces, start, end, weight)]
        elif choice.options:
            items = [(repr(option), weight)
                     for option, weight in zip(choice.options, edit.weights, strict=True)]
        elif choice.law is not None:
            items = self._by_law(edit, choice.law)
        else:
            items = list(zip(self._written_options(edit, edits), edit.weights, strict=True))
        if len({text for text, _ in items}) < len(items):
            raise self._refusal(f'{choice.dimension.name} has the same option twice', choice.place)
        return [(text, weight) for text, weight in items if weight > 0]

    def _written_options(self, edit: _Edit, edits: Sequence[_Edit]) -> list[str]:
        """Source text of options that are choices themselves."""
        name, place = edit.choice.dimension.name, edit.choice.place
        try:
            call = ast.parse(self.source[edit.start:edit.end], mode='eval').body
        except SyntaxError:
            call = None
        options = _option_nodes(call)
        if len(options) != len(edit.weights):
            raise self._refusal(f'the options of {name} do not stand there one by one', place)
        inner = [other for other in edits if other is not edit]
        spans = [_offsets(self.source[edit.start:edit.end], option) for option in options]
        return [
            self.rewrite(edit.start + start, edit.start + end, inner) for start, end in spans
        ]

    def _by_law(self, edit: _Edit, law: Law) -> list[tuple[str, float]]:
        """Truncated parts of a distribution that is not uniform between fixed ends."""
        edges = edit.choice.dimension.edges
        if law.kind == 'DiscreteRange' and law.low is not None and law.high is not None:
            return _whole_numbers(math.ceil(law.low), math.floor(law.high), edges, edit.weights)
        values = law.values(edges)
        if values is not None:
            bell = f'TruncatedNormal({law.mean:.12g}, {law.stddev:.12g}'
            parts = [f'{bell}, {_end(low)}, {_end(high)})'
                     for low, high in itertools.pairwise(values)]
        elif law.kind == 'Range':
            low, high = self._arguments(edit)
            between = [f'({low}) + {edge:.12g} * (({high}) - ({low}))' for edge in edges]
            parts = [f'Range({first}, {last})' for first, last in itertools.pairwise(between)]
        elif law.kind == 'Normal':
            mean, stddev = self._arguments(edit)
            parts = [f'({mean}) + ({stddev}) * TruncatedNormal(0, 1, {_end(low)}, {_end(high)})'
                     for low, high in itertools.pairwise(standard_values(edges))]
        else:
            name = edit.choice.dimension.name
            raise self._refusal(
                f'{name} is a {law.kind} of what is drawn itself', edit.choice.place
            )
        return list(zip(parts, edit.weights, strict=True))

    def _arguments(self, edit: _Edit) -> list[str]:
        """Source text of both arguments of a call, if it may be repeated."""
        text = self.source[edit.start:edit.end]
        name, place = edit.choice.dimension.name, edit.choice.place
        try:
            call = ast.parse(text, mode='eval').body
        except SyntaxError:
            call = None
        if not isinstance(call, ast.Call) or call.keywords or len(call.args) != 2:
            raise self._refusal(f'the two arguments of {name} do not stand there', place)
        if any(isinstance(part, ast.Call) for each in call.args for part in ast.walk(each)):
            raise self._refusal(
                f'{name} has a call as its argument; give that a name of its own first', place
            )
        spans = [_offsets(text, each) for each in call.args]
        return [text[start:end] for start, end in spans]

    def _span(self, choice: Choice) -> tuple[int, int]:
        name, place = choice.dimension.name, choice.place
        if place is None:
            raise self._refusal(f'{name} is made by no call that could be written anew')
        if Path(place.file).resolve() != self.program.resolve():
            raise self._refusal(f'{name} is not made in this file')
        if not (choice.pieces or choice.dimension.discrete or choice.law):
            raise self._refusal(f'{name} has no distribution that could be written', place)
        lines = _line_starts(self.source)
        start = lines[place.line - 1] + place.column
        end = lines[place.end_line - 1] + place.end_column
        if not _CALL.match(self.source, start) or self.source[end - 1:end] != ')':
            raise self._refusal(f'{name} is not made by Range, Normal, Uniform or Options', place)
        return start, end

    def _refusal(self, why: str, place: Place | None = None) -> UsageError:
        line = f':{place.line}' if place else ''
        return UsageError(f'{self.program.name}{line}: cannot be written back: {why}')


def _whole_numbers(
    low: int, high: int, edges: Sequence[float], weights: Sequence[float]
) -> list[tuple[str, float]]:
    """Ranges of integers with equal probability; a bin edge may split an integer's quantiles."""
    count = high - low + 1
    ends = np.arange(count + 1) / count
    # The learned distribution function is linear between the edges.
    shares = np.diff(np.interp(ends, edges, np.cumsum([0.0, *weights])))
    starts = [0, *(np.flatnonzero(~np.isclose(np.diff(shares), 0, atol=1e-12)) + 1).tolist(), count]
    return [
        (f'DiscreteRange({low + first}, {low + last - 1})', float(shares[first:last].sum()))
        for first, last in itertools.pairwise(starts)
    ]


def _end(value: float) -> str:
    return _number(value) if math.isfinite(value) else f"float('{value}')"


def _ranges(
    pieces: Sequence[Piece], start: float, end: float, weight: float
) -> list[tuple[str, float]]:
    """A bin's share of the pieces: uniform parts, and the probability of each."""
    items = []
    for piece in pieces:
        first, last = max(start, piece.start), min(end, piece.end)
        # Edges that differ by a rounding error are merged.
        if last - first > 1e-9:
            scale = (piece.high - piece.low) / (piece.end - piece.start)
            low, high = (piece.low + scale * (edge - piece.start) for edge in (first, last))
            items.append((f'Range({_number(low)}, {_number(high)})',
                          weight * (last - first) / (end - start)))
    return items


def _number(value: float) -> str:
    # Twelve digits, to write 1400 and not 1400.0000000000002.
    return f'{value:.12g}'


def _option_nodes(call: ast.expr | None) -> list[ast.expr]:
    if not isinstance(call, ast.Call) or call.keywords:
        return []
    if getattr(call.func, 'id', '') == 'Uniform':
        options = call.args
    elif len(call.args) == 1 and isinstance(call.args[0], ast.Dict):
        options = [key for key in call.args[0].keys if key is not None]
    elif len(call.args) == 1 and isinstance(call.args[0], (ast.List, ast.Tuple)):
        options = call.args[0].elts
    else:
        options = []
    return [option for option in options if not isinstance(option, ast.Starred)]


def _offsets(call: str, node: ast.expr) -> tuple[int, int]:
    """Start and end of an expression of ``call``; Python counts columns in bytes."""
    lines = _line_starts(call)

    def offset(line: int, column: int) -> int:
        return lines[line - 1] + len(call[lines[line - 1]:].encode()[:column].decode())

    assert node.end_lineno is not None
    assert node.end_col_offset is not None
    return offset(node.lineno, node.col_offset), offset(node.end_lineno, node.end_col_offset)


def _line_starts(text: str) -> list[int]:
    return [0, *(match.end() for match in re.finditer('\n', text))]


def _head(program: Path, source: str, origin: str) -> str:
    """The new docstring: the origin, then the old docstring."""
    match = _DOCSTRING.match(source)
    quoted = match[2].strip() if match else ''
    about = f'Learned from {program.name}' + (', which says of itself:' if quoted else '.')
    words = [origin.strip().replace('\\', '\\\\'), about, quoted]
    text = '\n\n'.join(part for part in words if part).replace('"""', "'''")
    return f'"""{text}\n"""\n'
