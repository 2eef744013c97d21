"""Scenic's functions for choices that an external sampler searches, without VerifAI.

A program marks them with ``VerifaiRange``, ``VerifaiDiscreteRange``, ``VerifaiOptions`` or
``VerifaiParameter.withPrior``. Scenic's own classes of these names need the package VerifAI, whose
last version (2.2.0) requires pandas < 3 and cannot be installed with this one. So the Scenic child
replaces them with functions, whether or not VerifAI is installed: each makes an ordinary choice
with the same prior, and marks it. Programs written for VerifAI compile unchanged, keep the weights
of their options under every sampler, and are searched by the samplers here. :func:`sampler_request`
reads the sampler that a program requests by its global parameters.

The child also records where in a program's text each choice is made (:func:`place_of`), so that the
search can write a learned distribution back. Only the Scenic child may import this module.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from numbers import Real
from types import FrameType
from typing import Any

import numpy as np
from scenic.core import distributions, external_params
from scenic.syntax import veneer

from taxinet_ros.samplers.space import Dimension
from taxinet_ros.scenes.constructs import program_frame
from taxinet_ros.scenes.program_sampler import BUCKETED, PARAMS, TYPE, VERIFAI_BUCKETS
from taxinet_ros.scenes.values import REJECTION_FEEDBACK, Place, ProgramError

_MARK, _PIECES, _PLACE = '_taxinet_buckets', '_taxinet_pieces', '_taxinet_place'
_FAR_SIGMAS = 5.0
"""Distance from the mean at which the distribution function has lost half of its digits."""
_PARTS = {'low': 'the low end', 'high': 'the high end', 'mean': 'the mean',
          'stddev': 'the standard deviation'}


class _Buckets:
    """Default number of buckets of ranges in the current program."""

    number = Dimension(name='').buckets
    some_say = False



def install() -> None:
    """Replace Scenic's functions; choices are checked where they are made, and record the place."""
    words = {
        'VerifaiRange': verifai_range, 'VerifaiDiscreteRange': verifai_discrete_range,
        'VerifaiOptions': verifai_options, 'VerifaiParameter': VerifaiParameter,
    }
    for module in (veneer, external_params):
        for name, word in words.items():
            setattr(module, name, word)
    whole, bell = distributions.DiscreteRange, distributions.TruncatedNormal
    whole.__init__ = _checking_weights(whole.__init__)
    for kind in (distributions.Range, distributions.Normal, bell, whole):
        kind.__init__ = _remembering(kind.__init__)
    bell.sampleGiven = _within_reach(bell.sampleGiven)
    # Scenic takes a choice // 1 for the choice.
    distributions.Distribution.__floordiv__ = lambda choice, divisor: (
        distributions.OperatorDistribution('__floordiv__', choice, (divisor,), {}))


def begin() -> None:
    """Reset for a new program."""
    _Buckets.number, _Buckets.some_say = Dimension(name='').buckets, False


def sampler_request(
    params: Mapping[str, Any], places: Mapping[str, Place]
) -> dict[str, Any]:
    """The sampler that a compiled program requests by global parameters, as plain values.

    Args:
        params: the program's global parameters.
        places: place where each of them is set.

    Raises:
        ProgramError: a sampler defined by the program, or a parameter of the wrong type.
    """
    own = params.get('externalSampler', external_params.VerifaiSampler)
    if own is not external_params.VerifaiSampler:
        raise ProgramError(
            "externalSampler: a sampler of the program's own cannot be used; name one by "
            f'"param {TYPE} = …" or as sampler', places.get('externalSampler'),
        )
    feedback = params.get(REJECTION_FEEDBACK)
    if REJECTION_FEEDBACK in params and (
        feedback is False or not isinstance(feedback, (int, float)) or not math.isfinite(feedback)
    ):
        raise ProgramError(
            f'{REJECTION_FEEDBACK} is {feedback!r:.60}; it has to be a number, the robustness that '
            'samplers learn for a rejected scene (True is 1), or left out',
            places.get(REJECTION_FEEDBACK),
        )
    kind, given = params.get(TYPE), params.get(PARAMS) or {}
    kind = None if kind is None else str(kind)
    if not isinstance(given, Mapping):
        raise ProgramError(f'{PARAMS} is a {type(given).__name__}; it has to be a DotMap or a dict',
                           places.get(PARAMS))
    plain = _plain(given)
    if kind in BUCKETED:
        _cut_ranges(plain, places.get(PARAMS))
    return {
        'kind': kind, 'params': plain,
        'feedback': None if feedback is None else float(feedback),
        'places': {name: places[name] for name in (TYPE, PARAMS) if name in places},
    }


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values; what no sampler here takes is only shown."""
    return {
        name: _plain(value) if isinstance(value, Mapping)
        else value if isinstance(value, (bool, int, float, type(None))) else str(value)
        for name, value in values.items()
        if not name.startswith('_')  # Scenic looks up its own attributes: a DotMap creates them
    }


def _cut_ranges(params: Mapping[str, Any], place: Place | None) -> None:
    """Set the default buckets of ranges as in the sampler that a program requests."""
    of_ranges = params.get('cont')
    if not isinstance(of_ranges, Mapping) or 'buckets' not in of_ranges:
        _Buckets.number = VERIFAI_BUCKETS
        return
    asked, where = of_ranges['buckets'], f'{PARAMS}.cont.buckets'
    if type(asked) is not int or asked < 1:
        raise ProgramError(f'{where} is {asked}; it has to be a whole number above 0; where ranges '
                           'differ write VerifaiRange(low, high, buckets=…)', place)
    if _Buckets.some_say:
        raise ProgramError(f'{where}: a VerifaiRange has buckets of its own, too; leave one of '
                           'them out', place)
    _Buckets.number = asked


def buckets_of(choice: Any) -> int | None:
    """Number of buckets of a choice marked for search; None for any other."""
    if _MARK not in vars(choice):
        return None
    return vars(choice)[_MARK] or _Buckets.number


def default_buckets() -> int:
    """Number of buckets of an unmarked choice, if no choice is marked."""
    return _Buckets.number


def pieces_of(choice: Any) -> list[list[float]]:
    """Pieces of a ``VerifaiRange`` with weights: quantiles from, to; values from, to."""
    pieces: list[list[float]] = vars(choice).get(_PIECES, [])
    return pieces


def place_of(choice: Any) -> list[Any] | None:
    """File, line, column, last line and end column (characters) of the call that made a choice."""
    place: list[Any] | None = vars(choice).get(_PLACE)
    return place


def verifai_range(
    low: Any, high: Any, buckets: int | None = None, weights: Iterable[float] | None = None
) -> Any:
    """``VerifaiRange``: a real interval, with ``weights`` of equal parts."""
    if weights is None:
        return _marked(distributions.Range(low, high), buckets)
    weights = _checked_weights(weights)
    if distributions.Range(low, high)._dependencies:
        raise ValueError('the ends of a VerifaiRange with weights are random; write numbers')
    if buckets not in (None, len(weights)):
        raise ValueError(f'VerifaiRange has {len(weights)} weights, but {buckets} buckets')
    sums = np.array([0.0, *itertools.accumulate(weights)])
    quantiles, values = sums / sums[-1], np.linspace(low, high, len(sums))
    unit = _marked(distributions.Range(0, 1), len(weights))
    ends = (quantiles[:-1], quantiles[1:], values[:-1], values[1:])
    setattr(unit, _PIECES, np.transpose(ends).tolist())

    def value_at(quantile: float) -> float:
        return float(np.interp(quantile, quantiles, values))

    return distributions.distributionFunction(value_at, valueType=float)(unit)


def verifai_discrete_range(
    low: int, high: int, weights: Iterable[float] | None = None
) -> Any:
    """``VerifaiDiscreteRange``: an inclusive integer interval."""
    return _marked(distributions.DiscreteRange(low, high, weights), None)


def verifai_options(options: Mapping[Any, float] | Iterable[Any]) -> Any:
    """``VerifaiOptions``: one of several values, with weights if it is a dict."""
    chosen = distributions.Options(options)
    _marked(chosen.index, None)
    return chosen


class VerifaiParameter:
    """The supported subset of Scenic's class of this name."""

    @staticmethod
    def withPrior(prior: Any, buckets: Any = None) -> Any:  # noqa: N802 (Scenic's name)
        """A choice with any prior, not approximated: a range, a normal or options."""
        _marked(prior.index if _is_options(prior) else prior, buckets)
        return prior


def _is_options(prior: Any) -> bool:
    return isinstance(prior, distributions.MultiplexerDistribution)


def _marked(choice: Any, buckets: Any) -> Any:
    if buckets is not None and (type(buckets) is not int or buckets < 1):
        raise ValueError(f'buckets is {buckets!s:.80}; it has to be a whole number above 0')
    setattr(choice, _MARK, buckets)
    _Buckets.some_say |= buckets is not None
    return choice


def _remembering(initialise: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(initialise)
    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        initialise(self, *args, **kwargs)
        _check_numbers(self)
        if (frame := program_frame()) is not None:
            setattr(self, _PLACE, _place(frame))

    return init


def _checking_weights(initialise: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(initialise)
    def init(self: Any, low: Any, high: Any, weights: Any = None, *rest: Any, **named: Any) -> None:
        given = None if weights is None else _checked_weights(weights)
        initialise(self, low, high, given, *rest, **named)

    return init


def _checked_weights(weights: Iterable[Any]) -> tuple[Any, ...]:
    if isinstance(weights, str) or not isinstance(weights, Iterable):
        raise ValueError(f'the weights are {weights!s:.80}; they have to be a list of numbers')
    given = tuple(weights)
    numbers = all(isinstance(weight, Real) and float(weight) >= 0 for weight in given)
    if not numbers or not 0 < sum(given) < math.inf:
        shown = ', '.join(map(str, given))
        raise ValueError(f'the weights are [{shown:.80}]; they have to be numbers of 0 or more, '
                         'and one of them above 0')
    return given


def _check_numbers(choice: Any) -> None:
    """Refuse a distribution from which nothing, or no number, can be drawn."""
    kind = type(choice).__name__
    for part, words in _PARTS.items():
        value = vars(choice).get(part)
        endless = part in ('low', 'high') and isinstance(choice, distributions.TruncatedNormal)
        if isinstance(value, Real) and not (math.isfinite(value) or (endless and value == value)):
            raise ValueError(f'{words} of a {kind} is {value}; it has to be a finite number')
    if isinstance(choice, distributions.Normal):
        spread, least = choice.stddev, distributions.supportInterval(choice.stddev)[0]
        if least is not None and least < 0:
            said = f'{spread:g}' if isinstance(spread, (int, float)) else f'{least:g} in some draws'
            raise ValueError(f'{_PARTS["stddev"]} of a {kind} is {said}; it has to be 0 or more')
    whole = {'low', 'high'} <= vars(choice).keys()  # and not only the normal of it
    if isinstance(choice, distributions.TruncatedNormal) and whole and not choice._dependencies:
        check_reach(choice.mean, choice.stddev, choice.low, choice.high)
    if isinstance(choice, distributions.DiscreteRange):
        least, most = choice.supportInterval()
        if None not in (least, most) and most < least + 1 and math.floor(most) < math.ceil(least):
            raise ValueError(f'a {kind} from {least:g} to {most:g} has no whole number')


def _within_reach(sample: Callable[..., float]) -> Callable[..., float]:
    @functools.wraps(sample)
    def sample_given(self: Any, given: Mapping[Any, Any]) -> float:
        check_reach(given[self.mean], given[self.stddev], self.low, self.high)
        return sample(self, given)

    return sample_given


def check_reach(mean: float, stddev: float, low: float, high: float) -> None:
    """Refuse a truncated normal so far from its mean that its inverse function loses digits."""
    if stddev == 0 or low - mean > _FAR_SIGMAS * stddev or mean - high > _FAR_SIGMAS * stddev:
        raise ValueError(
            f'a TruncatedNormal from {low:g} to {high:g} lies more than {_FAR_SIGMAS:g} standard '
            f'deviations of {stddev:g} from its mean {mean:g}; write Range(LOW, HIGH)'
        )


def _place(frame: FrameType) -> list[Any] | None:
    positions = itertools.islice(frame.f_code.co_positions(), frame.f_lasti // 2, None)
    line, end_line, column, end_column = next(positions)
    if None in (line, end_line, column, end_column):
        return None
    return [frame.f_code.co_filename, line, column, end_line, end_column]
