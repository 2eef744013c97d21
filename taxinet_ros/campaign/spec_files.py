"""Requirements as people give them: names, formulas, and YAML files of formulas and predicates.

A file has two keys, and either may be left out::

    predicates:
      on_centreline: abs(cte) <= 1.5
    specs:
      reach: 'F[0, 10] G on_centreline'
      gentle: 'always[10 s:inf](abs(steering) <= 3 deg)'

A predicate may use those above it, in its own file and in files given before. What comes out needs
no file any more: predicates are written out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.yaml_file import read_yaml
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import SIGNALS, parse_formula, parse_spec
from taxinet_ros.core.mtl.parser import parse

SUFFIXES = ('.yaml', '.yml')
_KEYS = ('predicates', 'specs')
_BRACKETS = "; a formula with brackets needs '…' quotes around it"


def read_specs(words: Iterable[str]) -> tuple[str, ...]:
    """The requirements that some words ask for, each as text that :func:`parse_spec` reads.

    Args:
        words: names of shipped formulas, ``NAME=FORMULA``, formulas, and YAML files of them. The
            order is kept.

    Raises:
        UsageError: a word or a file is no such thing, or two formulas have one name.
    """
    texts: list[str] = []
    predicates: dict[str, str] = {}
    for word in words:
        if word.strip().endswith(SUFFIXES):
            texts += _read(Path(word.strip()), predicates)
        else:
            spec = parse_spec(word, predicates)
            texts.append(_written_out('--spec', spec.name, spec.text) if predicates else word)
    names = [parse_spec(text).name for text in texts]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f'--spec: {name} is given twice; name one of them NAME=FORMULA')
    if predicates and not texts:
        raise UsageError('--spec: only predicates are given; add a formula that uses them')
    return tuple(texts)


def _read(path: Path, predicates: dict[str, str]) -> list[str]:
    """Texts of a file's formulas; its predicates are added to ``predicates``."""
    content = _mapping(path, '', read_yaml(path, option='--spec', mend=_BRACKETS))
    for key in content:
        if key not in _KEYS:
            raise UsageError(f'{path}: unknown key {key!r}; known: {", ".join(_KEYS)}')
    for name, text in _mapping(path, 'predicates', content.get('predicates')).items():
        if name in predicates:
            raise UsageError(f'{path}: predicates.{name}: there is one by that name already')
        where = f'{path}: predicates.{name}'
        formula = parse(_text(where, text), SIGNALS, predicates, where)
        _check_name(where, name)
        predicates[name] = str(formula)
    specs = _mapping(path, 'specs', content.get('specs'))
    if not specs and not predicates:
        raise UsageError(f'{path}: holds no formula; write specs: {{NAME: FORMULA}}')
    return [_spec_text(f'{path}: specs.{name}', name, text, predicates)
            for name, text in specs.items()]


def _spec_text(where: str, name: str, text: object, predicates: Mapping[str, str]) -> str:
    # Parsed by itself first, for an error message whose column is that in the file's text.
    return _written_out(where, name, str(parse(_text(where, text), SIGNALS, predicates, where)))


def _written_out(where: str, name: str, formula: str) -> str:
    text = f'{name}={formula}'
    try:
        parse_spec(text)  # the name may not be fit, or the formula too long by now
    except UsageError as error:
        raise UsageError(f'{where}: {error}') from None
    return text


def _check_name(where: str, name: str) -> None:
    try:
        parse_formula(name, {name: 'cte > 0'})
    except UsageError:
        raise UsageError(
            f'{where}: choose another name: letters, digits and _, and no signal or operator'
        ) from None


def _mapping(path: Path, key: str, value: object) -> dict[str, Any]:
    if value is None and key:
        return {}
    if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
        where = f'{path}: {key}' if key else f'{path}'
        raise UsageError(f'{where}: expected names with a formula each, NAME: FORMULA')
    return value


def _text(where: str, value: object) -> str:
    if not isinstance(value, str):
        raise UsageError(f"{where}: expected a formula, got {value!r:.60}; put it in '…' quotes")
    return value
