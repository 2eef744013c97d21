"""Requirements as users give them: names, formulas, and YAML files of formulas and predicates.

A file has two optional keys::

    predicates:
      on_centreline: abs(cte) <= 1.5
    specs:
      reach: 'F[0, 10] G on_centreline'
      gentle: 'always[10 s:inf](abs(steering) <= 3 deg)'

A predicate may use earlier ones, in its own file and in files given before. The resulting texts are
self-contained: predicates are expanded.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from taxinet_ros.core.mtl import (
    SHIPPED,
    SIGNALS,
    Assumptions,
    Spec,
    check_read,
    parse_assumptions,
    parse_formula,
    parse_spec,
)
from taxinet_ros.core.mtl.parser import parse
from taxinet_ros.core.verdict.judging import Judging, StopOn, parse_stop_on
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, read_yaml

DEFAULT_SPECS = ('phi_eventually',)
DEFAULT_JUDGING = Judging(specs=DEFAULT_SPECS)
SUFFIXES = ('.yaml', '.yml')
_KEYS = ('predicates', 'specs')
_BRACKETS = "; a formula with brackets needs '…' quotes around it"


def read_specs(words: Iterable[str]) -> tuple[str, ...]:
    """Read requirements; each result is a text for :func:`parse_spec`.

    Args:
        words: names of shipped formulas, ``NAME=FORMULA``, formulas, and YAML files of them. The
            order is kept.

    Raises:
        UsageError: a word or file is invalid, or two formulas have the same name.
    """
    texts: list[str] = []
    predicates: dict[str, str] = {}
    for word in words:
        if word.strip().endswith(SUFFIXES):
            texts += _read(Path(word.strip()), predicates)
        else:
            spec = parse_spec(word, predicates)
            # A package's named formula must be readable where the package is not installed.
            elsewhere = spec.name == word.strip() not in SHIPPED
            texts.append(
                _written_out('specs', spec.name, spec.text) if predicates or elsewhere else word
            )
    names = [parse_spec(text).name for text in texts]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f'specs: {name} is given twice; name one of them NAME=FORMULA')
    if predicates and not texts:
        raise UsageError('specs: only predicates are given; add a formula that uses them')
    return tuple(texts)


def _read(path: Path, predicates: dict[str, str]) -> list[str]:
    """Texts of a file's formulas; its predicates are added to ``predicates``."""
    top = Section(path, read_yaml(path, option='specs', fix=_BRACKETS), _KEYS)
    given = top.section('predicates', optional=True)
    for name in given:
        if name in predicates:
            raise given.wrong('there is one by that name already', name)
        where = f'{path}: predicates.{name}'
        formula = parse(given.text(name, kind='a formula'), SIGNALS, predicates, where)
        try:
            parse_formula(name, {name: 'cte > 0'})
        except UsageError:
            raise UsageError(
                f'{where}: choose another name: letters, digits and _, and no signal or operator'
            ) from None
        predicates[name] = str(formula)
    specs = top.section('specs', optional=True)
    texts = [
        _spec_text(f'{path}: specs.{name}', name, specs.text(name, kind='a formula'), predicates)
        for name in specs
    ]
    if not texts and not predicates:
        raise UsageError(f'{path}: has no formulas; write specs: {{NAME: FORMULA}}')
    return texts


def _spec_text(where: str, name: str, text: str, predicates: Mapping[str, str]) -> str:
    # Parsed by itself first, for an error message whose column is that in the file's text.
    return _written_out(where, name, str(parse(text, SIGNALS, predicates, where)))


def _written_out(where: str, name: str, formula: str) -> str:
    text = f'{name}={formula}'
    try:
        parse_spec(text)  # the name may be invalid, or the expanded formula too long
    except UsageError as error:
        raise UsageError(f'{where}: {error}') from None
    return text


def make_judging(
    specs: Iterable[str], stop_on: str = StopOn.NEVER, bounds: Iterable[str] = (),
    rates: Iterable[str] = (),
) -> Judging:
    """Check the judging arguments; see :func:`make_options`.

    Raises:
        UsageError: one line that names the parameter.
    """
    judging = Judging(
        specs=read_specs(specs) or DEFAULT_SPECS, stop_on=parse_stop_on(stop_on),
        bounds=tuple(bounds), rates=tuple(rates),
    )
    check_assumptions(judging.bounds, judging.rates, judging.parsed_specs)
    return judging


def check_assumptions(
    bounds: Iterable[str], rates: Iterable[str], specs: Sequence[Spec]
) -> Assumptions:
    """Parse assumptions on the signals.

    Args:
        bounds: as in :class:`.Judging`.
        rates: as in :class:`.Judging`.
        specs: requirements that read the signals; empty: not known.

    Raises:
        UsageError: one line that names the parameter.
    """
    found = parse_assumptions(bounds, rates)
    if specs:
        check_read(found, (spec.formula for spec in specs))
    return found
