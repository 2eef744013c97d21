"""What the paper says happens, held against what happened here: in kind, or not, or not clear."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from taxinet_ros.analysis.group_rates import Difference, difference
from taxinet_ros.study.claim import SIGNIFICANT, Claim, Verdict, by_groups, even_p, paired
from taxinet_ros.study.paper import CROSSING_M, EARLY_H, LATE_MORNING_H, LEARNED_EDGES_M
from taxinet_ros.study.plan import GENERIC, HALTON, ITERATIVE, ORIGINAL, SPECIALISED
from taxinet_ros.study.results import Network, Results, share_of


def judge_claims(results: Results) -> tuple[Claim, ...]:
    """Hold our runs against every statement that they can speak of."""
    parts: tuple[Callable[[Results], Iterator[Claim]], ...] = (
        _falsification, _debugging, _retraining, _learning, _iteration
    )
    return tuple(claim for part in parts for claim in part(results))


# Parts of the paper ------------------------------------------------------------------------------


def _falsification(results: Results) -> Iterator[Claim]:
    original = results.networks.get(ORIGINAL)
    if original is None:
        return
    early, late = (original.within('time_of_day_h', *hours) for hours in (EARLY_H, LATE_MORNING_H))
    yield by_groups(
        original, early, late, 'from 6 to 8 h', 'from 9:30 to 12 h', 'morning', 'section 3.3',
        'the original network fails more in the early morning than in the late morning',
    )
    at = original.within('distance_m', *CROSSING_M)
    yield by_groups(
        original, at, ~at, 'of starts at 1,200-1,600 m', 'of the others', 'crossing', 'section 3.3',
        'the original network fails around the crossing, more than along the rest of the runway',
    )


def _debugging(results: Results) -> Iterator[Claim]:
    found = results.localized
    truth = next(
        (one for one in (found or {}).get('substitutions', ()) if one['substitution'] == 'truth'),
        None,
    )
    if truth is not None and truth['judged']:
        passed, judged = truth['passed'], truth['judged']
        yield Claim(
            name='blame', source='section 3.3',
            statement='with ground truth for the network, every counterexample satisfies the '
            'formula: the network is to blame',
            verdict=Verdict.AGREES if passed == judged else Verdict.DIFFERS,
            evidence=f'{passed} of {judged} do '
            f'({_percent(truth["low"])}-{_percent(truth["high"])} %).',
        )
    yield from _shadows(results)


def _shadows(results: Results) -> Iterator[Claim]:
    found = results.experiments.get('shadows')
    if not found or not found['comparisons']:
        return
    rho, pairs = found['comparisons'][0]['rho'], found['comparisons'][0]['pairs']
    clear = rho['wilcoxon_p'] < SIGNIFICANT and rho['change'] is not None
    better = clear and rho['change'] > 0
    value, low, high = (rho[name] for name in ('change', 'low', 'high'))
    span = '' if low is None else f' ({low:+.2f} to {high:+.2f})'
    words = 'nothing to compare' if value is None else f'{value:+.2f} m{span}'
    yield Claim(
        name='shadows', source='section 3.3, Fig. 7',
        statement="without the aircraft's shadow, under a clear sky, the original network does "
        'better in the afternoon',
        verdict=Verdict.AGREES if better else Verdict.DIFFERS if clear else Verdict.UNCLEAR,
        evidence=f'robustness typically changes by {words} in {pairs} pairs of runs over the whole '
        f'day (p = {rho["wilcoxon_p"]:.2g}).',
    )


def _retraining(results: Results) -> Iterator[Claim]:
    yield from paired(results, ORIGINAL, GENERIC, +1, 'generic', 'section 3.4',
                       'images of the falsification program make a network that satisfies the '
                       'formula far more often (55.2 to 82 %)')
    yield from paired(results, ORIGINAL, GENERIC, -1, 'generic_off', 'section 3.4',
                       'images of the falsification program make a network that leaves the '
                       'runway less often (9.1 to 3.9 %)', off=True)
    yield from paired(results, GENERIC, HALTON, -1, 'halton_off', 'section 3.4',
                       'the Halton network leaves the runway less often than the generic one '
                       '(3.9 to 0.6 %)',
                       off=True)
    yield from _even_day(results)
    halton = results.networks.get(HALTON)
    if halton is not None:
        at = halton.within('distance_m', *CROSSING_M)
        yield by_groups(
            halton, at, ~at, 'of starts at 1,200-1,600 m', 'of the others', 'halton_crossing',
            'section 3.4', 'the Halton network still does not handle the crossing well',
        )
    yield from paired(results, HALTON, SPECIALISED, +1, 'specialised', 'section 3.4',
                       'the specialised network does better than the Halton one (83 to 86 %)')
    yield from paired(results, HALTON, SPECIALISED, +1, 'specialised_crossing', 'section 3.4',
                       'the specialised network does better than the Halton one around the '
                       'crossing', where='at')
    yield from paired(results, HALTON, SPECIALISED, -1, 'specialised_elsewhere', 'section 3.4',
                       'the specialised network does worse than the Halton one over the rest '
                       'of the runway', where='off')


def _learning(results: Results) -> Iterator[Claim]:
    choice, learned = results.distances, results.learned
    generic = results.networks.get(GENERIC)
    if choice is None or learned is None:
        return
    low, high = LEARNED_EDGES_M[2], LEARNED_EDGES_M[4]
    probability = choice.probability_within(
        low, high, learned.probabilities[choice.dimension.name])
    prior = choice.probability_within(low, high)
    evidence = (
        f'{_percent(probability)} % of the learned distribution starts there, {_percent(prior)} % '
        'of the program'
    )
    verdict = Verdict.UNCLEAR
    if generic is not None and generic.runs.failed.any():
        failures = share_of(generic.within('distance_m', low, high)[generic.runs.failed])
        evidence += (
            f'; of the {int(generic.runs.failed.sum()):,} failures among the {_runs(generic)} '
            f'random runs {_percent(failures.rate)} % '
            f'({_percent(failures.low)}-{_percent(failures.high)} %) do'
        )
        if failures.low > prior and probability > prior:
            verdict = Verdict.AGREES
        elif failures.high < prior and probability < prior:
            verdict = Verdict.DIFFERS
    yield Claim(
        name='learned', source='section 3.4', verdict=verdict, evidence=f'{evidence}.',
        statement='cross-entropy finds that the generic network fails at 1,200-1,600 m above all '
        '(95 % of what it learned)',
    )


def _iteration(results: Results) -> Iterator[Claim]:
    more, crossing, learned = ITERATIVE
    yield from paired(results, GENERIC, more, +1, 'iterative_generic', 'appendix A.1',
                       'further training with 20 % generic images does better than none '
                       '(82 to 85 %)')
    yield from paired(results, more, learned, -1, 'iterative_learned', 'appendix A.1',
                       'images of the learned failures do worse than generic ones (85 to 82 %)')
    yield from paired(results, more, crossing, -1, 'iterative_crossing', 'appendix A.1',
                       'images of the crossing do worse than generic ones (85 to 73 %)')
    yield from paired(results, GENERIC, crossing, -1, 'iterative_regression', 'appendix A.1',
                       'images of the crossing do worse than no further training (82 to 73 %)')


def _even_day(results: Results) -> Iterator[Claim]:
    """Whether the retrained networks still fail more at some hours than at others.

    A test that finds nothing proves nothing: what the original network has must be excluded too.
    """
    original = results.networks.get(ORIGINAL)
    for name in (GENERIC, HALTON):
        network = results.networks.get(name)
        if network is None or original is None:
            continue
        counts = _by_hour(network)
        p_value = even_p(counts)
        rates = 100 * counts[:, 0] / counts.sum(axis=1)
        gone = _morning(network).high < _morning(original).low
        verdict = Verdict.AGREES if p_value >= SIGNIFICANT and gone else Verdict.UNCLEAR
        test = 'too few for a test' if np.isnan(p_value) else f'chi-square test, p = {p_value:.2g}'
        yield Claim(
            name=f'{name}_day', source='section 3.4, Fig. 4',
            verdict=Verdict.DIFFERS if p_value < SIGNIFICANT else verdict,
            statement=f'the {name} network is as good at one hour of the day as at another',
            evidence=f'between {rates.min():.1f} and {rates.max():.1f} % of the runs of an hour '
            f'fail, of {_runs(network)} ({test}).',
        )


def _by_hour(network: Network) -> np.ndarray:
    """Failed and other runs of each hour."""
    hours = network.runs.frame['time_of_day_h'].to_numpy().astype(int)
    failed = network.runs.failed
    return np.array([
        [int((failed & (hours == hour)).sum()), int((~failed & (hours == hour)).sum())]
        for hour in np.unique(hours)
    ])


def _morning(network: Network) -> Difference:
    """How much more often it fails early in the morning than late."""
    rates = [
        network.runs.rate(network.within('time_of_day_h', *hours))
        for hours in (EARLY_H, LATE_MORNING_H)
    ]
    return difference(*rates)


def _runs(network: Network) -> str:
    return f'{len(network.runs.frame):,}'


def _percent(share: float) -> str:
    return f'{100 * share:.1f}'
