"""Draw the faults of ``seeded_faults.py``: at random, from a seed, over functions of each room.

Only functions are changed whose text is the same in another checkout, so that the tests of both can
be asked. What mypy or a person refuses is to be removed by hand.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import textwrap
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from common import count, leave

from seeded_faults import KINDS, ROOMS, Fault, Function, Source, sources, write_faults

from taxinet_ros.errors import ExitCode

_LEFT_OUT = ('trials/record/', 'trials/doctor.py', 'files/journal.py')
_UNITS = {1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9, 3.6, 60, 0.3048, 180.0}
_UNIT_NAME = re.compile(r'_PER_|_S_PER|NS$')
_ANGLES = {'radians', 'degrees', 'deg2rad', 'rad2deg'}
_FLIPPED = {
    ast.Lt: ('<', '<='), ast.LtE: ('<=', '<'), ast.Gt: ('>', '>='), ast.GtE: ('>=', '>'),
    ast.Eq: ('==', '!='), ast.NotEq: ('!=', '=='), ast.In: ('in', 'not in'),
    ast.NotIn: ('not in', 'in'), ast.Is: ('is', 'is not'), ast.IsNot: ('is not', 'is'),
}
_TEXT = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)

Edit = tuple[str, int, int, str]
"""A kind, where it begins and ends in the source [byte], and what is there instead."""




def _code(node: ast.AST) -> Iterator[ast.AST]:
    """What is run of a function, but for what only words a message."""
    for name, value in ast.iter_fields(node):
        if name in ('annotation', 'returns', 'decorator_list', 'exc', 'args') and not (
            name == 'args' and isinstance(node, ast.Call)
        ):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield child
                yield from _code(child)


def edits(source: Source, function: Function) -> Iterator[Edit]:
    """All faults that could be planted in a function."""
    for node in _code(function):
        begin, end = source.span(node) if hasattr(node, 'lineno') else (0, 0)
        if isinstance(node, ast.Compare):
            yield from _flip(source, node)
        elif isinstance(node, ast.If):
            word = source.data[begin : begin + 3]
            if not node.orelse and len(node.body) == 1 and word == b'if ' and isinstance(
                node.body[0], ast.Raise | ast.Return
            ):
                yield 'check', begin, end, 'pass'
        elif isinstance(node, ast.Constant) and type(node.value) is int:
            yield 'off by one', begin, end, str(node.value + (1 if begin % 2 else -1))
        elif isinstance(node, ast.Call):
            name = getattr(node.func, 'attr', getattr(node.func, 'id', ''))
            if name in _ANGLES and len(node.args) == 1:
                yield 'unit', begin, end, _operand(source, node.args[0])
        elif isinstance(node, ast.BinOp):
            yield from _arithmetic(source, node)


def _flip(source: Source, node: ast.Compare) -> Iterator[Edit]:
    sides = [node.left, *node.comparators]
    for left, op, right in zip(sides, node.ops, sides[1:], strict=False):
        word, other = _FLIPPED[type(op)]
        after = source.span(left)[1]
        at = source.data.find(word.encode(), after, source.span(right)[0])
        if at >= 0:
            yield 'comparison', at, at + len(word), other


def _arithmetic(source: Source, node: ast.BinOp) -> Iterator[Edit]:
    begin, end = source.span(node)
    if isinstance(node.op, ast.Add | ast.Sub):
        if any(isinstance(part, _TEXT) or isinstance(getattr(part, 'value', None), str)
               for part in ast.walk(node)):
            return
        word, other = ('+', '-') if isinstance(node.op, ast.Add) else ('-', '+')
        at = source.data.find(word.encode(), source.span(node.left)[1], end)
        yield 'sign', at, at + 1, other
    elif isinstance(node.op, ast.Mult | ast.Div | ast.FloorDiv):
        for factor, kept in ((node.right, node.left), (node.left, node.right)):
            name = getattr(factor, 'attr', getattr(factor, 'id', ''))
            if getattr(factor, 'value', None) in _UNITS or _UNIT_NAME.search(name):
                yield 'unit', begin, end, _operand(source, kept)
                return


def _operand(source: Source, node: ast.expr) -> str:
    begin, end = source.span(node)
    text = source.data[begin:end].decode()
    return f'({text})' if isinstance(node, ast.BinOp | ast.UnaryOp | ast.IfExp) else text


def draw(before: Path, seed: int, each: int) -> Iterator[Fault]:
    """Faults in functions that are the same in another checkout, too.

    Args:
        before: the other checkout.
        seed: of the choice.
        each: number of each kind in each room; each in another function.
    """
    folders = [folder for room in ROOMS.values() for folder in room]
    known = Counter(textwrap.dedent(source.text(function)) for source in sources(before, folders)
                    for function in source.functions.values())
    for room in ROOMS:
        choice = random.Random(f'{seed} {room}')
        places = [
            (source, name) for source in sources(Path.cwd(), ROOMS[room])
            if not source.path.startswith(_LEFT_OUT)
            for name, function in source.functions.items()
            if known[textwrap.dedent(source.text(function))] == 1
        ]
        choice.shuffle(places)
        for kind in sorted(KINDS, key=lambda kind: kind != 'unit'):  # the rarest chooses first
            found = 0
            for place in list(places):
                fault = _draw_one(choice, place[0], place[1], room, kind, found + 1)
                if fault is not None and found < each:
                    found += 1
                    places.remove(place)
                    yield fault


def _draw_one(
    choice: random.Random, source: Source, name: str, room: str, kind: str, number: int,
) -> Fault | None:
    function = source.functions[name]
    fitting = [edit for edit in edits(source, function) if edit[0] == kind]
    if not fitting:
        return None
    _, begin, end, text = choice.choice(fitting)
    first, last = source.lines(begin, end)
    old = source.data[first:last].decode()
    new = (source.data[first:begin] + text.encode() + source.data[end:last]).decode()
    if source.text(function).count(old) != 1:
        return None
    return Fault(f'{room}, {kind} {number}', room, kind, source.path, name, old, new)


def main(arguments: Sequence[str] | None = None) -> int:
    """Write a file of faults."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n\n')[0])
    parser.add_argument('before', type=Path, help='the other checkout')
    parser.add_argument('out', type=Path, help='file to write')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--each', type=count, default=3, help='faults of each kind in each room')
    given = parser.parse_args(arguments)
    write_faults(list(draw(given.before, given.seed, given.each)), given.out)
    return ExitCode.OK


if __name__ == '__main__':
    leave(main)
