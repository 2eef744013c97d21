"""Map the sampler that a program requests through Scenic parameters to one of ours.

Scenic has two global parameters for this, ``verifaiSamplerType`` and ``verifaiSamplerParams``,
which name a sampler of VerifAI (2.2.0, ``verifai.server.choose_sampler``) and its options;
docs/scenic.md has the table. Any other value of ``--sampler`` is accepted too, with its own option
names. Unsupported requests are refused with their line.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from taxinet_ros import registry
from taxinet_ros.errors import UsageError

TYPE, PARAMS = 'verifaiSamplerType', 'verifaiSamplerParams'

_VERIFAI = ('random', 'halton', 'ce', 'mab', 'grid', 'bo')
_DEFAULTS: Mapping[str, Mapping[str, str]] = {'ce': {'rule': 'verifai', 'alpha': '0.9'}}
_OPTIONS: Mapping[str, Mapping[str, str]] = {
    'ce': {'alpha': 'alpha'}, 'grid': {'N': 'points'}, 'bo': {'init_num': 'startup'},
}
"""VerifAI options that map to numeric options here, by sampler."""

BUCKETED = ('ce', 'mab')
"""VerifAI samplers that keep histograms."""

VERIFAI_BUCKETS = 5
"""Their default number of buckets per range."""

_BUCKETS = 'cont.buckets'
_HISTOGRAM = {'thres': 0, 'cont.dist': None, 'disc.dist': None}
_FIXED: Mapping[str, Mapping[str, Any]] = {
    'ce': _HISTOGRAM, 'mab': _HISTOGRAM, 'halton': {'sample_index': 0, 'bases_skipped': 0},
}
"""VerifAI options with a single supported value, by sampler."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ProgramSampler:
    """The sampler that a program requests.

    Attributes:
        word: name of the sampler here.
        options: its options, as text.
        said: the request as written and its line, for display.
        place: that line, as ``file:line``.
    """

    word: str
    options: Mapping[str, str] = field(default_factory=dict)
    said: str
    place: str


def program_sampler(
    kind: str | None, params: Mapping[str, Any], places: Mapping[str, str]
) -> ProgramSampler | None:
    """The sampler given by a program's two parameters; None if it names none.

    Args:
        kind: value of ``verifaiSamplerType``, or None.
        params: value of ``verifaiSamplerParams``.
        places: ``file:line`` of each of the two that is set.

    Raises:
        UsageError: an unsupported request, with its file and line.
    """
    if kind is None:
        if PARAMS in places:
            raise UsageError(
                f'{places[PARAMS]}: {PARAMS}: of which sampler? add "param {TYPE} = …"'
            )
        return None
    place = places[TYPE]
    options = dict(_DEFAULTS.get(kind, {}))
    for name, value in _flat(params):
        options.update(_option(kind, name, value, places[PARAMS]))
    _check(kind, options, place)
    return ProgramSampler(word=kind, options=options, said=f'{TYPE} = {kind!r}', place=place)


def _option(kind: str, name: str, value: Any, place: str) -> dict[str, str]:
    where = f'{place}: {PARAMS}.{name} = {value!r}'
    if name == _BUCKETS and kind in BUCKETED:
        return {}  # already applied to the choices
    fixed = _FIXED.get(kind, {})
    if name in fixed:
        if value != fixed[name]:
            raise UsageError(f'{where}: only {fixed[name]} can be had here; see docs/scenic.md')
        return {}
    known = _OPTIONS.get(kind, {}) if kind in _VERIFAI else {name: name}
    if name not in known:
        names = (*known, *fixed, *([_BUCKETS] if kind in BUCKETED else ()))
        raise UsageError(
            f'{where}: has no effect on {kind}; known: {", ".join(names) or "none"}; options of '
            'the sampler here are given as sampler_options'
        )
    return {known[name]: str(value)}


def _flat(params: Mapping[str, Any], above: str = '') -> Iterator[tuple[str, Any]]:
    for name, value in params.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{above}{name}.')
        else:
            yield f'{above}{name}', value


def _check(word: str, options: Mapping[str, str], place: str) -> None:
    # Imported here because the optimisers take 1 s to import and few programs name a sampler.
    from taxinet_ros.samplers.registry import SAMPLERS, check_sampler

    if word not in SAMPLERS:
        known = registry.known(registry.SAMPLERS)
        raise UsageError(f'{place}: {TYPE} = {word!r} is unknown; known: {known}')
    try:
        check_sampler(word, options)
    except UsageError as error:
        raise UsageError(f'{place}: {error}') from error
