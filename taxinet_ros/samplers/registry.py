"""The table of samplers, and the factory that creates one by name."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

from taxinet_ros import registry
from taxinet_ros.arguments import can_be_called
from taxinet_ros.errors import UsageError, near_miss
from taxinet_ros.registry import Extension, Extensions
from taxinet_ros.samplers import space_filling
from taxinet_ros.samplers.active_search import ActiveSearch
from taxinet_ros.samplers.covering import Cells, Covering, Wanted, own_cells
from taxinet_ros.samplers.histogram import Bandit, CrossEntropy, VerifaiRule
from taxinet_ros.samplers.optuna_study import Bayes, cmaes, tpe
from taxinet_ros.samplers.sampler import (
    Exhausted,
    Lagged,
    Option,
    Probabilities,
    Proposer,
    Sampler,
    WithDrawn,
    parse_options,
)
from taxinet_ros.samplers.space import Dimension, Point, Space
from taxinet_ros.samplers.space_filling import Grid
from taxinet_ros.samplers.splitting import make_splitting
from taxinet_ros.samplers.stress import Stress

Values = Mapping[str, float]
_T = TypeVar('_T')


def _floor_option(default: float, low: float = 0.0) -> Mapping[str, Option]:
    """The option ``floor``: the share of runs that a rate is estimated from."""
    return {'floor': Option(
        meaning='share of the runs drawn from the program, on which rates rest',
        default=default, low=low, high=1.0,
    )}


@dataclass(frozen=True, kw_only=True, slots=True)
class SamplerKind:
    """A sampler of the table that reports for each run whether it was drawn from the prior.

    Rates are estimated from those runs alone (:mod:`taxinet_ros.trials.rates`), so they are valid
    with any sampler, whatever it does with the other runs.

    Attributes:
        meaning: description in one line.
        make: factory; takes space, seed, number of runs and option values.
        options: the sampler's options by name.
        learns: whether its points depend on results of earlier runs; if not, any number of them
            may be in flight.
        batched: whether a run may depend on the result of the one before it
            (:class:`.sampler.Batched`), not only on those up to ``LAG`` before.
        by_likelihood: whether it searches for the likeliest failure: all that the program draws has
            to be normal then (:mod:`taxinet_ros.trials.stress`).
        rules: variants with options of their own, by the word of the option ``rule``.
    """

    meaning: str
    make: Callable[[Space, int, int, Values], Sampler]
    options: Mapping[str, Option] = field(default_factory=dict)
    learns: bool = True
    batched: bool = False
    by_likelihood: bool = False
    rules: Mapping[str, SamplerKind] = field(default_factory=dict)


def _check_make(where: str, make: Callable[..., object]) -> None:
    """Check that a factory takes the arguments of :attr:`SamplerKind.make`."""
    if not can_be_called(make, 'space', 'seed', 'runs', 'values'):
        raise UsageError(f'{where}: its make cannot be called as make(space, seed, runs, values)')


def proposer_kind(
    meaning: str, make: Callable[[Space, int, int, Values], Proposer], *, floor: float,
    options: Mapping[str, Option] | None = None, learns: bool = True,
) -> SamplerKind:
    """The table row of a sampler that only proposes: a share of prior draws is mixed in.

    Args:
        meaning: description in one line.
        make: factory, see :attr:`SamplerKind.make`. A sampler with a method ``add`` receives the
            results of prior draws.
        floor: default of the option ``floor``, the share of prior draws. With 0 there is no rate,
            and the sampler's sequence is unchanged.
        options: its own options.
        learns: see :attr:`SamplerKind.learns`.

    Raises:
        UsageError: the factory takes other arguments.
    """
    _check_make('proposer_kind', make)
    return SamplerKind(
        meaning=meaning, learns=learns, options={**(options or {}), **_floor_option(floor)},
        make=lambda space, seed, runs, values: WithDrawn(
            make(space, seed, runs, values), space, seed, values['floor']
        ),
    )


_STARTUP = Option(
    meaning='results before the model is used; plain draws until then',
    default=10, low=2, high=1e6, whole=True,
)

RANDOM = SamplerKind(
    meaning='independent draws from the program',
    make=lambda space, seed, runs, values: space_filling.Random(space, seed),
    learns=False,
)
HALTON = proposer_kind(
    'evenly spread points (Halton, scrambled)',
    lambda space, seed, runs, values: space_filling.halton(space, seed), floor=0.0,
    learns=False,
)
SOBOL = proposer_kind(
    'evenly spread points (Sobol, scrambled); best with 2^n runs',
    lambda space, seed, runs, values: space_filling.sobol(space, seed), floor=0.0,
    learns=False,
)
GRID = proposer_kind(
    'all combinations of even steps and categories, widely spaced ones first',
    lambda space, seed, runs, values: Grid(space, seed, runs, points=int(values['points'])),
    floor=0.0, learns=False,
    options={
        'points': Option(
            meaning='steps of each continuous dimension; 0: as many as fit into the runs',
            default=0, low=0, high=1e6, whole=True,
        ),
    },
)
ACTIVE = proposer_kind(
    'active search: finds rare failures, and all the regions of them',
    lambda space, seed, runs, values: ActiveSearch(space, seed, radius=values['radius']),
    floor=0.25,
    options={
        'radius': Option(
            meaning='around a failure, where others are no news [quantiles]',
            default=0.1, low=0.001, high=1.0,
        ),
    },
)
COVERAGE = proposer_kind(
    'where no run has been: every pair of cells of the ranges, or of an ODD',
    lambda space, seed, runs, values: Covering(
        space, seed, *own_cells(space, int(values['cells']), int(values['strength']))
    ),
    floor=0.0,
    options={
        'cells': Option(
            meaning='parts of each continuous dimension; with an ODD its own',
            default=4, low=1, high=50, whole=True,
        ),
        'strength': Option(
            meaning='cells in a combination: 1, 2 (pairs) or 3', default=2, low=1, high=3,
            whole=True,
        ),
    },
)
_VERIFAI_RULE = SamplerKind(
    meaning='cross-entropy by the rule of VerifAI: heads for the likeliest failure',
    make=lambda space, seed, runs, values: VerifaiRule(
        space, seed, alpha=values['alpha'], floor=values['floor']
    ),
    options={
        **_floor_option(0.0),
        'alpha': Option(
            meaning='what a failure leaves of the old histograms',
            default=0.9, low=0.5, high=0.99999,
        ),
    },
)
CE = SamplerKind(
    meaning='cross-entropy with importance weights: learns where failures are',
    make=lambda space, seed, runs, values: CrossEntropy(
        space, seed, floor=values['floor'], every=int(values['every'])
    ),
    options={
        **_floor_option(0.3, low=0.01),
        'every': Option(
            meaning='results between two fits', default=50, low=1, high=1e6, whole=True,
        ),
    },
    rules={'verifai': _VERIFAI_RULE},
)
MAB = SamplerKind(
    meaning='multi-armed bandit over buckets (upper confidence bound)',
    make=lambda space, seed, runs, values: Bandit(
        space, seed, floor=values['floor'], explore=values['explore']
    ),
    options={
        **_floor_option(0.1, low=0.01),
        'explore': Option(
            meaning='how much little-tried buckets are favoured', default=0.3, low=0, high=100,
        ),
    },
)
BO = proposer_kind(
    'Bayesian optimisation with a Gaussian process: fewest runs to a minimum',
    lambda space, seed, runs, values: Bayes(
        space, seed, startup=int(values['startup']), window=int(values['window'])
    ),
    floor=0.1,
    options={
        'startup': _STARTUP,
        'window': Option(
            meaning='most results it is fitted to', default=100, low=10, high=1000, whole=True,
        ),
    },
)
TPE = proposer_kind(
    'tree-structured Parzen estimator: towards a minimum, cheaply',
    lambda space, seed, runs, values: tpe(space, seed, startup=int(values['startup'])),
    floor=0.1,
    options={'startup': _STARTUP},
)
CMAES = proposer_kind(
    'evolution strategy CMA-ES: into one minimum',
    lambda space, seed, runs, values: cmaes(
        space, seed, population=int(values['population'])
    ),
    floor=0.1,
    options={
        'population': Option(
            meaning='runs per generation; 0: 4 + 3 ln(dimensions)',
            default=0, low=0, high=1e5, whole=True,
        ),
    },
)


SPLITTING = SamplerKind(
    meaning='chains down the levels of robustness: for taxinet estimate',
    make=make_splitting, batched=True,
    options={
        'draws': Option(
            meaning='plain draws at first', default=1000, low=10, high=1e9, whole=True,
        ),
        'particles': Option(
            meaning='points of the pilot at each level after these, a multiple of 5',
            default=40, low=10, high=1e5, whole=True,
        ),
        'islands': Option(
            meaning='populations beside a pilot; their mean gives the lower end',
            default=8, low=2, high=100, whole=True,
        ),
        'floor': Option(
            meaning='least probability to look for', default=1e-6, low=1e-12, high=0.5,
        ),
    },
)
STRESS = replace(proposer_kind(
    'adaptive stress testing: towards the likeliest disturbances that fail',
    lambda space, seed, runs, values: Stress(space, seed), floor=0.0,
), by_likelihood=True)


class PluginSampler(Sampler):
    """A package's sampler; its errors become one-line usage errors that name the package."""

    def __init__(self, extension: Extension, make: Callable[[], Sampler], space: Space) -> None:
        """Create the sampler.

        Args:
            extension: origin of the sampler.
            make: creates the package's sampler.
            space: the space its points must belong to.

        Raises:
            UsageError: the package's code fails; every method raises it.
        """
        self._extension, self._space = extension, space
        self._sampler = self._call(make)

    def ask(self) -> Point:
        """See :class:`.Sampler`."""
        return self._checked(self._call(self._sampler.ask))

    def again(self) -> Point:
        """Another point for the same run."""
        return self._checked(self._call(self._sampler.again))

    def tell(self, index: int, rho: float | None) -> None:
        """Pass a result on."""
        self._call(lambda: self._sampler.tell(index, rho))

    def weight(self, index: int) -> float | None:
        """See :class:`.Sampler`."""
        return self._call(lambda: self._sampler.weight(index))

    def drawn(self, index: int) -> bool:
        """See :class:`.Sampler`."""
        return self._call(lambda: self._sampler.drawn(index))

    def learned(self) -> Probabilities:
        """See :class:`.Sampler`."""
        return self._call(self._sampler.learned)

    def _checked(self, point: Point) -> Point:
        self._call(lambda: self._space.check(point))
        return point

    def _call(self, work: Callable[[], _T]) -> _T:
        try:
            return work()
        except Exhausted:
            raise
        except Exception as error:
            raise self._extension.failure(error) from error


def _kind(extension: Extension, found: object) -> SamplerKind:
    """Check the sampler kind that a package registers; errors become one-line usage errors."""
    if not isinstance(found, SamplerKind):
        raise UsageError(
            f'{extension.words}: {extension.target} is {type(found).__name__}; expected a '
            'SamplerKind (taxinet_ros.samplers.registry)'
        )
    if extension.shipped:
        return found
    _check_make(f'{extension.words}: {extension.target}', found.make)
    return replace(found, make=lambda space, seed, runs, values: PluginSampler(
        extension, lambda: found.make(space, seed, runs, values), space
    ))


SAMPLERS: Mapping[str, SamplerKind] = Extensions(registry.SAMPLERS, _kind)
"""Every sampler by name."""
BY_SIZE = ('tpe', 'bo', 'cmaes')
"""Those that minimise, so that it matters to them how low a failure is."""


def make_sampler(
    name: str, dimensions: Iterable[Dimension], seed: int, runs: int, /, **options: str | float
) -> Lagged:
    """Make the sampler of a campaign.

    Args:
        name: key of :data:`SAMPLERS`.
        dimensions: the dimensions to search.
        seed: seed of the campaign, 0 or more.
        runs: number of runs planned, which determines the grid; more may be requested.
        options: sampler options, as numbers or text.

    Raises:
        UsageError: unknown name or option (the known ones are listed), an invalid value, a negative
            seed, or dimensions that form no valid space.
    """
    kind, given = _variant(name, options)
    values = parse_options(name, kind.options, given)
    if seed < 0:
        raise UsageError(f'seed is {seed}; it has to be 0 or more')
    space = Space(dimensions)
    if not space and name != 'random':
        raise UsageError(
            f'sampler {name}: nothing that the program draws can be searched; sampler random '
            'draws as it does'
        )
    return Lagged(kind.make(space, seed, runs, values))


def make_covering_sampler(
    dimensions: Iterable[Dimension], seed: int, wanted: Wanted,
    cells: Callable[[Point], Cells | None], /, **options: str | float
) -> tuple[Lagged, Covering]:
    """Make the sampler ``coverage`` of a campaign for cells of scenes, such as those of an ODD.

    Args:
        dimensions: the dimensions to search.
        seed: seed of the campaign, 0 or more.
        wanted: the combinations to cover.
        cells: cells of the scene of a point; None outside.
        options: sampler options, as numbers or text.

    Returns:
        The sampler of the campaign, and the one inside that knows its reach.

    Raises:
        UsageError: an unknown option or invalid value.
    """
    values = check_sampler('coverage', options)
    space = Space(dimensions)
    covering = Covering(space, seed, wanted, cells)
    return Lagged(WithDrawn(covering, space, seed, values['floor'])), covering


def drawn_share(name: str, options: Mapping[str, str | float]) -> float:
    """Share of a sampler's runs drawn from the prior, from which rates are estimated."""
    return check_sampler(name, options).get('floor', 1.0)


def check_sampler(name: str, options: Mapping[str, str | float]) -> Values:
    """All option values of a sampler, given and default.

    Raises:
        UsageError: unknown name or option (the known ones are listed), or a value that is not
            allowed.
    """
    kind, given = _variant(name, options)
    return parse_options(name, kind.options, given)


def _variant(
    name: str, options: Mapping[str, str | float]
) -> tuple[SamplerKind, dict[str, str | float]]:
    """The sampler with the rule that its options name, and the other options."""
    kind, given = SAMPLERS.get(name), dict(options)
    if kind is None:
        near = near_miss(name, registry.names(registry.SAMPLERS))
        raise UsageError(
            f'sampler {name!r} is unknown{near}; known: {registry.known(registry.SAMPLERS)}'
        )
    if not kind.rules or 'rule' not in given:
        return kind, given
    rule = given.pop('rule')
    if rule not in kind.rules:
        known = ', '.join(kind.rules)
        raise UsageError(f'sampler {name}: rule={rule}: unknown; known: {known}, or leave it out')
    return kind.rules[str(rule)], given
