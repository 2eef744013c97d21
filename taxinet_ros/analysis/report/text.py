"""The text of an analysis, written in a template beside it, for the terminal and the page alike.

A template is plain text. A paragraph is a sentence of the report; those before the first section
are its summary. Some lines have a meaning of their own::

    # title
    - name: value           a fact, left out if it has no value
    ## name: heading        a section, left out if nothing is in it
    $ command
    [words](path)           a link to another page

Nothing in it is markup: the page escapes all text.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

from taxinet_ros.analysis.report.parts import Link, Picture, Report, Section, Table
from taxinet_ros.core.mtl import SIGNALS, parse_formula
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.mtl.lint import formula_words
from taxinet_ros.trials.rates import count_words

_TITLE, _SECTION, _FACT, _COMMAND, _LINK = map(re.compile, (
    r'# (.+)', r'## ([\w-]+): (.+)', r'- ([^:]+):\s*(.*)', r'\$ (.+)', r'\[(.+)\]\((.+)\)'))
_MARKS = (_TITLE, _SECTION, _FACT, _COMMAND, _LINK)


def sentences(path: Path, block: str, **values: Any) -> tuple[str, ...]:
    """The sentences of one block of a template.

    Args:
        path: the template.
        block: name of the block.
        values: values of its names.
    """
    template = _template(path)
    text = ''.join(template.blocks[block](template.new_context(values)))
    return tuple(_paragraphs(text))


def macro_text(path: Path, macro: str, **values: Any) -> str:
    """Text of one macro of a template, as a command prints it, without the last line's end.

    Args:
        path: the template.
        macro: name of the macro.
        values: its arguments.
    """
    text: str = getattr(_template(path).module, macro)(**values)
    return text.removesuffix('\n')


def fill_report(
    template: Path, values: Mapping[str, Any],
    figures: Mapping[str, Sequence[Picture | Table]], **more: Any,
) -> Report:
    """A report from a template.

    Args:
        template: the template.
        values: values of its names; a name without one is an error.
        figures: pictures and tables of the sections, by their names.
        more: what of the :class:`Report` is not text: its runs and their names.
    """
    summary, *parts = _split(_template(template).render(values))
    sections = [_section(part, figures.get(part.name, ())) for part in parts]
    if lost := figures.keys() - {section.name for section in sections}:
        raise ValueError(f'{template.name}: no section {", ".join(sorted(lost))}')
    return Report(
        title=summary.heading, summary=tuple(summary.sentences),
        facts={name: value for name, value in summary.facts.items() if value},
        sections=tuple(section for section in sections if _shown(section)), **more,
    )


@dataclass(slots=True)
class _Part:
    """The text of the summary, or of a section."""

    name: str
    heading: str
    sentences: list[str] = field(default_factory=list)
    facts: dict[str, str] = field(default_factory=dict)
    commands: list[str] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)


def _split(text: str) -> list[_Part]:
    """The parts of a text, the summary first; what has no meaning where it stands is a sentence."""
    parts = [_Part('', '')]
    for line in _paragraphs(text):
        here, summary = parts[-1], len(parts) == 1
        if found := _SECTION.fullmatch(line):
            parts.append(_Part(found[1], found[2]))
        elif summary and not here.heading and (found := _TITLE.fullmatch(line)):
            here.heading = found[1]
        elif summary and (found := _FACT.fullmatch(line)):
            here.facts[found[1]] = found[2]
        elif not summary and (found := _COMMAND.fullmatch(line)):
            here.commands.append(found[1])
        elif not summary and (found := _LINK.fullmatch(line)):
            here.links.append(Link(words=found[1], path=found[2]))
        else:
            here.sentences.append(line)
    return parts


def _section(part: _Part, figures: Sequence[Picture | Table]) -> Section:
    return Section(
        name=part.name, heading=part.heading, sentences=tuple(part.sentences),
        commands=tuple(part.commands), links=tuple(part.links),
        pictures=tuple(one for one in figures if isinstance(one, Picture)),
        tables=tuple(one for one in figures if isinstance(one, Table)),
    )


def _shown(section: Section) -> bool:
    return bool(
        section.sentences or section.commands or section.links or section.pictures
        or any(table.rows for table in section.tables)
    )


def _paragraphs(text: str) -> Iterator[str]:
    """Paragraphs, each on one line; lines with a meaning of their own are not joined."""
    lines: list[str] = []
    for line in [*text.splitlines(), '']:
        marked = any(mark.fullmatch(line.rstrip()) for mark in _MARKS)
        if lines and (marked or not line.strip()):
            yield ' '.join(' '.join(lines).split())
            lines = []
        if marked:
            yield line.strip()
        elif line.strip():
            lines.append(line)


def _template(path: Path) -> Template:
    return environment(path.parent).get_template(path.name)


@functools.cache
def environment(folder: Path) -> Environment:
    """Jinja for the plain text of a folder's templates, with the filters for numbers."""
    found = Environment(
        loader=FileSystemLoader(folder), undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, autoescape=False,  # plain text, no markup
    )
    found.tests['known'] = lambda value: value is not None and math.isfinite(value)
    found.filters |= {
        'count': lambda number: f'{number:,}',
        'many': lambda number, noun: f'{number:,} {noun}{"" if number == 1 else "s"}',
        'percent': lambda share, digits=1: f'{decimals(100 * share, digits)} %',
        'points': lambda share, digits=1: decimals(100 * share, digits, sign='+'),
        'decimals': decimals,
        'counts': count_words,
        'rho': rho_text,
        'signed': lambda value, digits=2: decimals(value, digits, sign='+'),
        'p': p_words,
        'file_name': _file_name,
        'formula': lambda text: formula_words(parse_formula(text), SIGNALS),
        'capital': lambda text: text[:1].upper() + text[1:],
    }
    return found


def _file_name(word: str) -> str:
    """A word, or the name of its file: where that lies on this machine says nothing elsewhere."""
    path = Path(word)
    return path.name if path.is_absolute() else word


def p_words(value: float) -> str:
    """Display text of a p value."""
    return 'p < 0.001' if value < 0.001 else f'p = {value:.3f}'


def decimals(value: float, digits: int, sign: str = '') -> str:
    """A number with some decimals and a true minus."""
    return f'{value:{sign}.{digits}f}'.replace('-', '−')
