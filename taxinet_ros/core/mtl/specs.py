"""Signals that formulas may read, with units, and the named formulas that are shipped."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from taxinet_ros import registry
from taxinet_ros.arguments import TEXT, check_fields, takes
from taxinet_ros.core.mtl import ast
from taxinet_ros.core.mtl.lexer import RESERVED
from taxinet_ros.core.mtl.lower_bounds.builder import check_parts
from taxinet_ros.core.mtl.parser import parse
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.units import dimension_of
from taxinet_ros.errors import UsageError, near_miss

SIGNALS: Mapping[str, str] = MappingProxyType(
    {
        'cte': 'm',
        'he': 'rad',
        'speed': 'm/s',
        'x': 'm',
        'steering': 'rad',
        'cte_estimate': 'm',
        'he_estimate': 'rad',
        'cte_sigma': 'm',
        'he_sigma': 'rad',
        'estimate_gap': 's',
        'unusable_share': '1',
        'clearance': 'm',
        'collision': '1',
        'hold_distance': 'm',
    }
)
"""Unit of each signal. ``cte``, ``he``, ``speed`` and ``x`` are ground truth relative to the track,
which by default is the runway's centreline; ``x`` is the distance along it. ``steering`` is the
command; the estimates are from the perception, the sigmas the standard deviations that they claim.
Signs are defined in :mod:`taxinet_ros.core.types`: cross-track, heading and steering are left
positive. ``estimate_gap`` is the time since the last usable estimate, 0 if this frame has one;
``unusable_share`` is the number of frames so far without one divided by that of all frames of the
run; it only grows. ``clearance`` is the distance from the aircraft to others on the ground, and
``collision`` 1 where it is 0, else 0; ``hold_distance`` is the way from the nose along the track to
the nearest hold line that is not cleared, negative beyond it
(:mod:`taxinet_ros.core.clearance`)."""

MOST_CLEARANCE_M = 1000.0
"""Greatest ``clearance``; what it is where nobody else is on the ground [m]."""

MOST_HOLD_DISTANCE_M = 1000.0
"""Greatest ``hold_distance``; what it is where no hold line is left to be cleared [m]."""

SWITCHES = frozenset({'collision'})
"""Signals that are 0 or 1, which are no shares."""

OF_OTHERS = frozenset({'clearance', 'collision', 'hold_distance'})
"""Signals about others on the ground."""

CENTRELINE_TOLERANCE_M = 1.5
"""Largest |cross-track error| that counts as on the centreline [m] (the paper's two formulas)."""

SETTLING_TIME_S = 10
"""Time within which phi_eventually requires the aircraft to be on the centreline to stay [s]."""

LONGEST_BLIND_S = 0.5
"""Longest time without a usable estimate in ``usable`` [s]: 2.5 m of taxiing."""

MOST_UNUSABLE_SHARE = 0.05
"""Largest share of a run's frames without a usable estimate in ``usable``."""

LEAST_CLEARANCE_M = 3.0
"""Distance to others on the ground in ``keep_clear`` [m]."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Spec:
    """A named requirement.

    >>> import taxinet_ros as tx
    >>> tx.Spec.parse('gentle=always(abs(steering) <= 3 deg)').name
    'gentle'

    Attributes:
        name: snake_case identifier, valid in topics, columns and file names.
        formula: the formula.
        text: the formula fully parenthesised; it parses back to an equal formula.
    """

    name: str
    formula: ast.Formula = field(repr=False)
    text: str

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    @takes(text=TEXT)
    def parse(cls, text: str) -> Spec:
        """Parse a requirement; see :func:`parse_spec`."""
        return parse_spec(text)


def parse_formula(text: str, predicates: Mapping[str, str] | None = None) -> ast.Formula:
    """Parse a formula over :data:`SIGNALS`; see :func:`taxinet_ros.core.mtl.parser.parse`."""
    return parse(text, SIGNALS, predicates)


def _spec(name: str, formula: ast.Formula) -> Spec:
    check_parts(formula)
    return Spec(name=name, formula=formula, text=str(formula))


PHI_ALWAYS = f'always(abs(cte) <= {CENTRELINE_TOLERANCE_M})'
PHI_EVENTUALLY = f'eventually[0:{SETTLING_TIME_S}]({PHI_ALWAYS})'
ON_RUNWAY = f'always(abs(cte) <= {KMWH_HALF_WIDTH_M})'
USABLE = (
    f'always(estimate_gap <= {LONGEST_BLIND_S} and unusable_share <= {MOST_UNUSABLE_SHARE})'
)
NO_COLLISION = 'always(clearance > 0)'
KEEP_CLEAR = f'always(clearance >= {LEAST_CLEARANCE_M})'
HOLD_SHORT = 'always(hold_distance >= 0)'
SHIPPED: Mapping[str, Spec] = MappingProxyType({
    name: _spec(name, parse_formula(text))
    for name, text in zip(
        registry.SHIPPED[registry.REQUIREMENTS],
        (PHI_ALWAYS, PHI_EVENTUALLY, ON_RUNWAY, USABLE, NO_COLLISION, KEEP_CLEAR, HOLD_SHORT),
        strict=True,
    )
})
"""The shipped formulas by name. The paper prints ``CTE <= 1.5``; its tool monitors 1.5 - |CTE|
(VerifAI, examples/xplane), and so do these."""

_NAMED = re.compile(r'\s*([A-Za-z_][A-Za-z0-9_]*)\s*=(?![=>])(.*)', re.DOTALL)
_NAME = re.compile(r'[a-z][a-z0-9_]*')


def parse_spec(
    text: str, predicates: Mapping[str, str] | None = None, signals: Collection[str] = SIGNALS,
) -> Spec:
    """Parse a requirement.

    Args:
        text: the name of a formula that is shipped or provided by a package, ``NAME=FORMULA``, or a
            bare formula. A bare formula is named ``spec_`` and a hash of its parenthesised text, so
            its name does not depend on spacing or aliases.
        predicates: formulas by name that the formula may use.
        signals: names that the formula may read; a mapping gives their units too.

    Raises:
        UsageError: an unknown name, a bad name, a bad formula, or a shipped or provided formula
            about signals in other units.
    """
    word = text.strip()
    if word in SHIPPED:
        registry.find(registry.REQUIREMENTS, word)  # Rejects a package that defines it too.
        return _readable(SHIPPED[word], signals)
    named = _NAMED.fullmatch(text)
    if named is not None:
        # Spaces in place of the name keep the columns of error messages right.
        return _named(named.group(1), ' ' * named.start(2) + named.group(2), predicates, signals)
    if word.isidentifier() and word not in (predicates or {}):
        return _readable(_of_package(word), signals)
    formula = parse(text, signals, predicates)
    digest = hashlib.sha256(str(formula).encode()).hexdigest()[:8]
    return _spec(f'spec_{digest}', formula)


def _of_package(name: str) -> Spec:
    """Requirement that an installed package provides under a name.

    Raises:
        UsageError: an unknown name, a package that cannot be imported, or an invalid formula.
    """
    extension = registry.find(registry.REQUIREMENTS, name)
    if extension is None:
        raise UsageError(
            f'spec: unknown name {name!r}{near_miss(name, registry.names(registry.REQUIREMENTS))}; '
            f'known: {registry.known(registry.REQUIREMENTS)}; or write NAME=FORMULA'
        )
    text = extension.load()
    if not isinstance(text, str):
        raise UsageError(f'{extension.words}: {extension.target} is {type(text).__name__}; '
                         'expected the text of a formula')
    try:
        return _named(name, text, None, SIGNALS)
    except UsageError as error:
        raise UsageError(f'{extension.words}: {error}') from None


def _readable(spec: Spec, signals: Collection[str]) -> Spec:
    missing = [name for name in ast.signal_names(spec.formula) if name not in signals]
    if missing:
        raise UsageError(
            f'spec {spec.name}: reads {missing[0]}, which is no signal; known: {", ".join(signals)}'
        )
    units = signals if isinstance(signals, Mapping) else SIGNALS
    for name in ast.signal_names(spec.formula):
        if dimension_of(units[name]) not in (None, dimension_of(SIGNALS[name])):
            raise UsageError(
                f'spec {spec.name}: reads {name} in {SIGNALS[name]}, here it is in {units[name]}'
            )
    return spec


def _named(
    name: str, body: str, predicates: Mapping[str, str] | None, signals: Collection[str]
) -> Spec:
    if name in signals:
        raise UsageError(
            f'spec: {name!r} is a signal, no name; a comparison is one of <=, <, >=, >'
        )
    if not _NAME.fullmatch(name) or name in RESERVED:
        raise UsageError(
            f'spec: name {name!r} needs to be snake_case and no operator, e.g. my_spec'
        )
    formula = parse(body, signals, predicates, where=f'spec {name}')
    shipped = SHIPPED.get(name)
    if shipped is not None and shipped.formula != formula:
        raise UsageError(f'spec: {name!r} is shipped as {shipped.text}; choose another name')
    return _spec(name, formula)
