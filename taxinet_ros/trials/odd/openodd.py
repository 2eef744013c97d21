"""Write an ODD as ASAM OpenODD 1.0 YAML, with the binding file of openodd-py.

What is written: a concept of the taxonomy for each parameter, a root module with the ranges, and a
module for each exclusion. Read by openodd-py 0.13.0, the module holds for exactly the scenes that
are inside here (docs/odd.md, which also has what does not fit). Cells are not part of OpenODD: they
are the buckets of the binding file.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.core.scenario_fields import Kind, ScenarioField
from taxinet_ros.core.units import ANGLE, LENGTH, SHARE, SPEED, TIME, UNITS
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import dump_yaml
from taxinet_ros.trials.odd.odd_file import Exclusion, Odd, Parameter

ROOT = 'inside_odd'
_TYPES = {LENGTH: 'length', TIME: 'time', ANGLE: 'angle', SPEED: 'velocity', SHARE: 'ratio'}
_UNITS = {'°': 'deg'}


def openodd_values(odd: Odd, document: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """An ODD as the values of an OpenODD document, and of a binding file.

    Args:
        odd: the operational design domain.
        document: name of the document's file, which the binding file names.

    Raises:
        UsageError: something of it has no form in OpenODD.
    """
    taxonomy: dict[str, Any] = {}
    modules: dict[str, Any] = {}
    root: dict[str, Any] = {}
    probes: dict[str, Any] = {}
    for one in odd.parameters:
        taxonomy[one.key] = _type(one)
        root |= _inside(one, modules)
        probes[one.key] = {'probe': one.key, **_buckets(one)}
    for number, exclusion in enumerate(odd.exclusions, 1):
        modules[f'excluded_{number}'] = {
            'DESCRIPTION': exclusion.why, 'INCLUDE_AND': _box(odd, exclusion),
        }
    excluded = {f'excluded_{number}': True for number in range(1, len(odd.exclusions) + 1)}
    modules[ROOT] = {
        'DESCRIPTION': odd.source or odd.name, 'INCLUDE_AND': root,
        **({'EXCLUDE_OR': excluded} if excluded else {}),
    }
    binding = {'openodd': [document], 'name': odd.name, 'text': odd.source, 'probes': probes}
    return {'TAXONOMY': taxonomy, 'MODULES': modules}, binding


def openodd_texts(odd: Odd, document: str) -> tuple[str, str]:
    """The same as YAML."""
    written, binding = openodd_values(odd, document)
    return dump_yaml(written), dump_yaml(binding)


def binding_path(out: Path) -> Path:
    """The binding file beside an OpenODD document."""
    return out.with_name(f'{out.stem}.binding.yaml')


def _unit(field: ScenarioField) -> str:
    return _UNITS.get(field.unit, field.unit)


def _type(one: Parameter) -> str | list[str]:
    if one.field.kind is Kind.SWITCH:
        return 'boolean'
    if not one.numeric:
        return [cell.word for cell in one.cells]
    if not one.field.unit:
        return 'float'
    known = UNITS.get(one.field.unit)
    name = None if known is None else _TYPES.get(known.dimension)
    if name is None:
        raise UsageError(
            f'{one.key}: its unit {one.field.unit} is none of OpenODD, so it cannot be exported'
        )
    return f'float {name}'


def _interval(field: ScenarioField, low: float, high: float) -> str:
    return f'[{low:.12g} .. {high:.12g}] {_unit(field)}'.rstrip()


def _words(one: Parameter, words: list[str]) -> Any:
    return words[0] == 'True' if one.field.kind is Kind.SWITCH else words


def _inside(one: Parameter, modules: dict[str, Any]) -> dict[str, Any]:
    """The condition that a parameter is in one of its cells; parts of it become modules."""
    if not one.numeric:
        words = [cell.word for cell in one.cells]
        if one.field.kind is Kind.SWITCH and len(words) > 1:
            return {}
        return {one.key: _words(one, words)}
    spans = [(cell.low, cell.high) for cell in one.cells if cell.low == cell.high]
    ranged = [cell for cell in one.cells if cell.low < cell.high]
    if ranged:
        spans.append((ranged[0].low, ranged[-1].high))
    if len(spans) == 1:
        return {one.key: _interval(one.field, *spans[0])}
    names = [f'{one.key}_{number}' for number in range(1, len(spans) + 1)]
    for name, span in zip(names, spans, strict=True):
        modules[name] = {'INCLUDE_AND': {one.key: _interval(one.field, *span)}}
    modules[f'{one.key}_any'] = {'INCLUDE_OR': dict.fromkeys(names, True)}
    return {f'{one.key}_any': True}


def _box(odd: Odd, exclusion: Exclusion) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for number, (low, high) in exclusion.numbers.items():
        one = odd.parameters[number]
        found[one.key] = _interval(one.field, low, high)
    for number, words in exclusion.words.items():
        one = odd.parameters[number]
        found[one.key] = _words(one, [cell.word for cell in one.cells if cell.word in words])
    return found


def _buckets(one: Parameter) -> Mapping[str, Any]:
    if not one.numeric:
        switch = one.field.kind is Kind.SWITCH
        return {'values': [cell.word == 'True' if switch else cell.word for cell in one.cells]}
    # Buckets of openodd-py are edges; a single value has no bucket of its own.
    ranged = [cell for cell in one.cells if cell.low < cell.high]
    unit = {'unit': _unit(one.field)} if one.field.unit else {}
    edges = [ranged[0].low, *(cell.high for cell in ranged)] if ranged else []
    return {**unit, **({'buckets': edges} if edges else {})}
