"""Results and statements of the paper, compared qualitatively with our runs.

Fremont, Chiu, Margineantu, Osipychev and Seshia, Formal Analysis and Redesign of a Neural
Network-Based Aircraft Taxiing System with VerifAI, CAV 2020. Its figures are of its own networks in
its own simulator; none of them is used for tuning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from taxinet_ros.analysis.experiment.pairs import PairedRates, paired_shift
from taxinet_ros.core.scenario_fields import CLOUDS
from taxinet_ros.study.report.claim import (
    Claim,
    all_of,
    evenly_often,
    judge,
    more_often,
    more_often_by,
    mostly,
    mostly_lower,
    pairs_more_often,
    share_above,
)
from taxinet_ros.study.report.results import Network, Results
from taxinet_ros.study.stages.plan import (
    GENERIC,
    HALTON,
    ITERATIVE,
    ORIGINAL,
    PAPER_RULE,
    SPECIALISED,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class PaperNetwork:
    """A network's rates, as fractions.

    Attributes:
        satisfied: share of the runs that satisfy phi_eventually.
        off_runway: share that leaves the runway; None if not in the paper.
        source: place in the paper.
    """

    satisfied: float
    off_runway: float | None
    source: str

_DEBUGGING, _RETRAINING, _APPENDIX = 'section 3.3', 'section 3.4', 'appendix A.1'
PAPER_NETWORKS = {
    ORIGINAL: PaperNetwork(satisfied=0.552, off_runway=0.091, source='section 3.2'),
    GENERIC: PaperNetwork(satisfied=0.82, off_runway=0.039, source=_RETRAINING),
    HALTON: PaperNetwork(satisfied=0.83, off_runway=0.006, source=_RETRAINING),
    SPECIALISED: PaperNetwork(satisfied=0.86, off_runway=0.005, source=_RETRAINING),
    ITERATIVE[0]: PaperNetwork(satisfied=0.85, off_runway=None, source=_APPENDIX),
    ITERATIVE[1]: PaperNetwork(satisfied=0.73, off_runway=None, source=_APPENDIX),
    ITERATIVE[2]: PaperNetwork(satisfied=0.82, off_runway=None, source=_APPENDIX),
}
"""Networks by the study's names."""
PAPER_RUNS = 4_000
"""Approximate number of runs with each network."""
LEARNED_EDGES_M = (0.0, 200.0, 1200.0, 1400.0, 1600.0, 2000.0)
"""Ends of the stretches of runway that the paper distinguishes [m]."""
PAPER_LEARNED = (0.05, None, 0.16, 0.79, None)
"""What cross-entropy learned of the generic network's failures, by stretch (section 3.4)."""
CROSSING_M = (1200.0, 1600.0)
"""Starts that bracket the crossing near 1,450 m (Fig. 8)."""
START_M = (0.0, 400.0)
"""Starts at which the paper's model also has difficulty (Figs. 6 and 8)."""
EARLY_H, LATE_MORNING_H = (6.0, 8.0), (9.5, 12.0)
"""When the original network consistently fails and when it works well (section 3.3, Fig. 4); the
limits are ours, the paper gives none."""
EIGHT_H, TWO_H, AFTERNOON_H = (7.0, 9.0), (13.0, 15.0), (12.0, 18.0)
"""About 8 am and 2 pm (Fig. 5), and the afternoon of Fig. 7; the limits are ours."""
ALMOST_ALL = 0.95
"""Share of runs required by "almost all" and "always"; ours, the paper gives none."""
SEVERAL_M = 2.0
"""Minimum required by "several meters" [m]; ours."""
EVEN = 0.10
"""Difference of rates allowed by "consistent across the entire day", and required of "factors
leading to" failures; ours."""
EXTREME_DEG, FAR_M = 20.0, 5.0
"""Least "extreme angle" [°] and offset "further away from the centerline" [m]; ours."""


_TOLERANCE_M = 1.5
_PARTS_OF_DAY_H = ((6.0, 9.0), (9.0, 12.0), (12.0, 15.0), (15.0, 18.0))
_AT, _OFF = 'that start at 1,200-1,600 m', 'that start elsewhere'


def judge_claims(results: Results) -> tuple[Claim, ...]:
    """Test every statement that our runs can decide, all as one family."""
    parts: tuple[Callable[[Results], Iterator[Claim]], ...] = (
        _day, _clouds, _runway, _start, _blame, _shadows, _retraining, _even_day, _learning,
        _iteration,
    )
    return judge([claim for part in parts for claim in part(results)])

# Falsification and debugging ---------------------------------------------------------------------


def _day(results: Results) -> Iterator[Claim]:
    original = results.networks.get(ORIGINAL)
    if original is None:
        return
    failed = original.runs.failed
    early, late = (
        failed[original.within('time_of_day_h', *hours)] for hours in (EARLY_H, LATE_MORNING_H)
    )
    yield Claim(
        name='morning', source=f'{_DEBUGGING}, Fig. 4', sides=more_often(early, late),
        statement='the original network fails more in the early morning than in the late morning',
        evidence=f'from 6 to 8 h {_fail(original, early)}, '
        f'from 9:30 to 12 h {_fail(original, late)}.',
    )
    yield Claim(
        name='early_morning', source=f'{_DEBUGGING}, Fig. 4',
        sides=mostly(int(early.sum()), int((~early).sum())),
        statement='the original network consistently fails in the early morning (most runs)',
        evidence=f'from 6 to 8 h {_fail(original, early)}.',
    )
    yield Claim(
        name='late_morning', source=f'{_DEBUGGING}, Fig. 4',
        sides=share_above(int((~late).sum()), len(late), ALMOST_ALL),
        statement='the original network works well in the late morning, almost all runs satisfying '
        f'the formula (more than {_percent(ALMOST_ALL, 0)} %)',
        evidence=f'from 9:30 to 12 h {_share(original, ~late)} satisfy it.',
    )


def _clouds(results: Results) -> Iterator[Claim]:
    original = results.networks.get(ORIGINAL)
    if original is None:
        return
    frame = original.runs.frame
    known = frame['rho'].to_numpy(dtype=float)
    dry = (frame['rain_percent'] == 0).to_numpy() & ~np.isnan(known)
    for name, hours, words, first, second in (
        ('clouds_morning', EIGHT_H, 'at 8 am', 'stratus', 'clear'),
        ('clouds_reversal', TWO_H, 'at 2 pm', 'clear', 'stratus'),
    ):
        there = dry & original.within('time_of_day_h', *hours)
        rho = {
            sky: known[there & (frame['clouds'] == sky).to_numpy()]
            for sky in (first, second)
        }
        yield Claim(
            name=name, source=f'{_DEBUGGING}, Fig. 5', sides=mostly_lower(rho[first], rho[second]),
            statement=f'{words} the original network performs worse under {_sky(first)} than under '
            f'{_sky(second)}',
            evidence=f'of the dry runs from {hours[0]:g} to {hours[1]:g} h the median ρ is '
            f'{" and ".join(_median(rho[sky], _sky(sky)) for sky in (first, second))}.',
        )


def _runway(results: Results) -> Iterator[Claim]:
    """Stretches where a network fails more often than along the rest of the runway."""
    for name, what, words, source in (
        (ORIGINAL, 'crossing', 'fails around the crossing, more than along the rest of the runway',
         f'{_DEBUGGING}, Fig. 6'),
        (HALTON, 'crossing', 'still does not handle the crossing well: it fails there, more than '
         'along the rest of the runway', _RETRAINING),
        (GENERIC, 'crossing', "has its worst performance where the learned program's starts are, "
         'around the crossing', _RETRAINING),
        (ORIGINAL, 'start', 'has difficulty at the start of the runway: it fails more than '
         'elsewhere off the crossing', _RETRAINING),
        (HALTON, 'start', 'has difficulty at the start of the runway: it fails more than elsewhere '
         'off the crossing', _RETRAINING),
    ):
        network = results.networks.get(name)
        if network is None:
            continue
        there = network.within('distance_m', *(CROSSING_M if what == 'crossing' else START_M))
        others = ~there & ~network.within('distance_m', *CROSSING_M)
        at, off = network.runs.failed[there], network.runs.failed[others]
        place = '1,200-1,600 m' if what == 'crossing' else '0-400 m'
        rest = 'of the others' if what == 'crossing' else 'at 400-1,200 and 1,600-2,000 m'
        yield Claim(
            name=f'{name}_{what}', source=source, statement=f'the {_title(name)} network {words}',
            sides=more_often(at, off),
            evidence=f'of starts at {place} {_fail(network, at)}, {rest} {_fail(network, off)}.',
        )


def _start(results: Results) -> Iterator[Claim]:
    """What else leads to failures, "even at favorable times and runway positions"."""
    original = results.networks.get(ORIGINAL)
    if original is None:
        return
    failed, frame = original.runs.failed, original.runs.frame
    good = original.within('time_of_day_h', *LATE_MORNING_H)
    good &= ~original.within('distance_m', *CROSSING_M)
    for name, column, least, words in (
        ('angle', 'heading_deg', EXTREME_DEG, f'at an extreme angle (more than {EXTREME_DEG:g}°)'),
        ('offset', 'cross_track_m', FAR_M,
         f'further away from the centreline (more than {FAR_M:g} m)'),
    ):
        there = (frame[column].abs() > least).to_numpy()
        tested = failed[there & good], failed[~there & good]
        yield Claim(
            name=f'original_{name}', source=_DEBUGGING, sides=more_often_by(*tested, EVEN),
            statement=f'even at favourable times and places (9:30 to 12 h, off the crossing) '
            f'starting {words} is a factor that leads to failures of the original network (at '
            f'least {_percent(EVEN, 0)} points more often)',
            evidence=f'then and there of such starts {_fail(original, tested[0])}, of the others '
            f'{_fail(original, tested[1])}; at all times and places of such starts '
            f'{_fail(original, failed[there])}, of the others {_fail(original, failed[~there])}.',
        )


def _blame(results: Results) -> Iterator[Claim]:
    truth = next((
        one for one in (results.localized or {}).get('substitutions', ())
        if one['substitution'] == 'truth'
    ), None)
    if truth is not None and truth['judged']:
        passed, judged = truth['passed'], truth['judged']
        yield Claim(
            name='blame', source=_DEBUGGING, sides=share_above(passed, judged, ALMOST_ALL),
            statement='with ground truth for the network the counterexamples satisfy the formula '
            f'(more than {_percent(ALMOST_ALL, 0)} %): the network is to blame',
            evidence=f'{passed:,} of {judged:,} do '
            f'({_percent(truth["low"])}-{_percent(truth["high"])} %).',
        )


def _shadows(results: Results) -> Iterator[Claim]:
    """Fig. 7: one place, a clear sky, and only the afternoon, when there is a shadow."""
    pairs = results.experiment_pairs.get('shadows')
    if pairs is None:
        return
    known = pairs.dropna(subset=['rho_shadows', 'rho_no_shadows']).sort_values('time_of_day_h')
    known = known[known['time_of_day_h'].between(*AFTERNOON_H)]
    rho = known[['rho_shadows', 'rho_no_shadows']].to_numpy(dtype=float)
    if not len(rho):
        return
    gain = rho[:, 1] - rho[:, 0]
    shift = paired_shift(rho[:, 0].tolist(), rho[:, 1].tolist())
    failing = [int((column <= 0).sum()) for column in rho.T]
    yield Claim(
        name='shadows', source=f'{_DEBUGGING}, Fig. 7',
        sides=mostly(int((gain > 0).sum()), int((gain < 0).sum())),
        statement="under a clear sky, in the afternoon, the original network does better without "
        "the aircraft's shadow",
        evidence=f'ρ grows in {shift.more} and shrinks in {shift.less} of {shift.pairs} pairs from '
        f'12 to 18 h, typically by {shift.change.value:+.2f} m '
        f'({shift.change.low:+.2f} to {shift.change.high:+.2f}); with the shadow '
        f'{failing[0]} of them fail, without it {failing[1]}.',
    )
    steps = np.abs(rho[1::2] - rho[:len(rho) // 2 * 2:2])
    if not len(steps):
        return
    yield Claim(
        name='shadows_fluctuation', source=f'{_DEBUGGING}, Fig. 7',
        sides=mostly(int((steps[:, 0] > steps[:, 1]).sum()),
                     int((steps[:, 0] < steps[:, 1]).sum())),
        statement='in the afternoon its performance fluctuates with the shadow, and less without',
        evidence='from one run to the next in the day ρ changes by '
        f'{steps[:, 0].mean():.2f} m with '
        f'the shadow and {steps[:, 1].mean():.2f} m without (means of {len(steps)} steps).',
    )

# Retraining --------------------------------------------------------------------------------------


def _retraining(results: Results) -> Iterator[Claim]:
    yield from _paired(results, ORIGINAL, GENERIC, +1, 'generic', _RETRAINING,
                       'images of the falsification program make a network that satisfies the '
                       'formula more often (55.2 to 82 %)')
    yield from _paired(results, ORIGINAL, GENERIC, -1, 'generic_off', _RETRAINING,
                       'images of the falsification program make a network that leaves the '
                       'runway less often (9.1 to 3.9 %)', off=True)
    yield from _paired(results, GENERIC, HALTON, +1, 'halton', _RETRAINING,
                       'the Halton network satisfies the formula more often than the generic one '
                       '(82 to 83 %)')
    yield from _paired(results, GENERIC, HALTON, -1, 'halton_off', _RETRAINING,
                       'the Halton network leaves the runway less often than the generic one '
                       '(3.9 to 0.6 %)', off=True)
    yield from _paired(results, ORIGINAL, HALTON, -1, 'halton_off_original', _RETRAINING,
                       'the Halton network leaves the runway less often than the original one '
                       '(9.1 to 0.6 %)', off=True)
    yield from _paired(results, ORIGINAL, SPECIALISED, -1, 'specialised_off_original', _RETRAINING,
                       'the specialised network leaves the runway less often than the original '
                       'one (9.1 to 0.5 %)', off=True)
    yield from _paired(results, HALTON, SPECIALISED, +1, 'specialised', _RETRAINING,
                       'the specialised network does better than the Halton one (83 to 86 %)')
    yield from _paired(results, HALTON, SPECIALISED, +1, 'specialised_crossing', _RETRAINING,
                       'the specialised network does better than the Halton one around the '
                       'crossing', where=_AT)
    yield from _specialised_elsewhere(results)
    yield from _several_metres(results)


def _specialised_elsewhere(results: Results) -> Iterator[Claim]:
    found = [
        _pair_of(results, other, SPECIALISED, where=_OFF) for other in (GENERIC, HALTON)
    ]
    known = [rates for rates in found if rates is not None]
    if len(known) == len(found):
        yield Claim(
            name='specialised_elsewhere', source=_RETRAINING,
            statement='the specialised network does worse than the generic and the Halton one over '
            'the rest of the runway',
            sides=all_of([pairs_more_often(rates).opposite for rates in known]),
            evidence='; '.join(
                _pair_words(rates, _title(other), SPECIALISED, 'satisfy', _OFF)
                for rates, other in zip(known, (GENERIC, HALTON), strict=True)
            ) + '.',
        )


def _several_metres(results: Results) -> Iterator[Claim]:
    """Deviation of several metres; after ten seconds ρ is 1.5 m minus the greatest deviation."""
    network = results.networks.get(SPECIALISED)
    if network is None:
        return
    there = network.within('distance_m', *CROSSING_M)
    rho = network.runs.frame['rho'].to_numpy(dtype=float)[there]
    away = _TOLERANCE_M - rho[~np.isnan(rho)]
    far = away > SEVERAL_M
    yield Claim(
        name='specialised_metres', source=_RETRAINING,
        sides=mostly(int(far.sum()), int((~far).sum())),
        statement='around the crossing the specialised network still typically deviates several '
        f'metres from the centreline (most runs by more than {SEVERAL_M:g} m)',
        evidence=f'of starts at 1,200-1,600 m {_share(network, far)} deviate by more than '
        f'{SEVERAL_M:g} m after ten seconds; the median is {_typical(away)} m.'
        if len(far) else 'no run.',
    )


def _even_day(results: Results) -> Iterator[Claim]:
    for name in (GENERIC, HALTON):
        network = results.networks.get(name)
        if network is None:
            continue
        clouds = network.runs.frame['clouds'].to_numpy()
        groups = _parts_of_day(network, np.full(len(clouds), True))
        shares = ', '.join(
            f'{_percent(network.share(group).rate)} % of {len(group):,} from {low:g} to {high:g} h'
            for group, (low, high) in zip(groups, _PARTS_OF_DAY_H, strict=True) if len(group)
        )
        what = f'no three hours fail {_percent(EVEN, 0)} points more or less often than the rest'
        yield Claim(
            name=f'{name}_day', source=f'{_RETRAINING}, Fig. 4', sides=evenly_often(groups, EVEN),
            statement=f"the {_title(name)} network's performance is consistent across the day "
            f'({what})',
            evidence=f'fail: {shares}.',
        )
        under = {sky: _parts_of_day(network, clouds == sky) for sky in CLOUDS}
        yield Claim(
            name=f'{name}_day_clouds', source=_RETRAINING,
            sides=all_of([evenly_often(groups, EVEN) for groups in under.values()]),
            statement=f"the {_title(name)} network's performance is consistent across the day for "
            f'each cloud type individually ({what})',
            evidence='least and most of three hours fail: ' + '; '.join(
                f'{_spread(groups)} under {_sky(sky)}' for sky, groups in under.items()
            ) + '.',
        )


def _parts_of_day(network: Network, among: np.ndarray) -> list[np.ndarray]:
    """Whether the runs of some scenes fail, by part of the day; the last one has its end."""
    last = _PARTS_OF_DAY_H[-1][1]
    return [
        network.runs.failed[among & network.within(
            'time_of_day_h', low, np.nextafter(high, high + 1) if high == last else high)]
        for low, high in _PARTS_OF_DAY_H
    ]


def _spread(groups: Sequence[np.ndarray]) -> str:
    shares = [float(group.mean()) for group in groups if len(group)]
    if not shares:
        return 'no run'
    runs = sum(map(len, groups))
    return f'{_percent(min(shares))} and {_percent(max(shares))} % of {runs:,}'


def _iteration(results: Results) -> Iterator[Claim]:
    more, crossing, learned = ITERATIVE
    yield from _paired(results, GENERIC, more, +1, 'iterative_generic', _APPENDIX,
                       'further training with 20 % generic images does better than none '
                       '(82 to 85 %)')
    yield from _paired(results, more, learned, -1, 'iterative_learned', _APPENDIX,
                       'images of the learned failures do worse than generic ones (85 to 82 %)')
    yield from _paired(results, more, crossing, -1, 'iterative_crossing', _APPENDIX,
                       'images of the crossing do worse than generic ones (85 to 73 %)')
    yield from _paired(results, GENERIC, crossing, -1, 'iterative_regression', _APPENDIX,
                       'images of the crossing do worse than no further training (82 to 73 %)')


def _paired(
    results: Results, first: str, second: str, sign: int, name: str, source: str, statement: str, *,
    off: bool = False, where: str = '',
) -> Iterator[Claim]:
    """Whether the second network is positive more often (``sign`` +1) or less often (-1)."""
    rates = _pair_of(results, first, second, off=off, where=where)
    if rates is not None:
        sides = pairs_more_often(rates)
        yield Claim(
            name=name, statement=statement, source=source,
            sides=sides if sign > 0 else sides.opposite,
            evidence=_pair_words(
                rates, _title(first), _title(second), 'leave the runway' if off else 'satisfy',
                where) + '.',
        )


def _pair_of(
    results: Results, first: str, second: str, *, off: bool = False, where: str = ''
) -> PairedRates | None:
    pair = results.pair(first, second)
    if pair is None:
        return None
    at = pair.at(*CROSSING_M)
    among = {_AT: at, _OFF: ~at}.get(where)
    return pair.off_runway() if off else pair.satisfied(among)

# Learning ----------------------------------------------------------------------------------------


def _learning(results: Results) -> Iterator[Claim]:
    """Tests of the paper's learning rule only; the table also shows the results of ours."""
    choice = results.distances
    found = results.searches.get(PAPER_RULE, ())
    if choice is None or not found:
        return

    def within(low: float, high: float) -> np.ndarray:
        return np.array([
            choice.probability_within(low, high, one.probabilities[choice.dimension.name])
            for one in found
        ])

    before, on, end = LEARNED_EDGES_M[2:5]
    crossing, at_start = within(before, end), within(*LEARNED_EDGES_M[:2])
    for name, more, less, statement, evidence in (
        ('learned', crossing, 1 - crossing,
         "cross-entropy by VerifAI's rule comes to a distribution of the generic network's "
         'failures with starts at 1,200-1,600 m above all (95 % of it)',
         f'{_searches(crossing)} of what was learned, '
         f'{_percent(choice.probability_within(before, end), 0)} % of the program'),
        ('learned_on_crossing', within(on, end), within(before, on),
         'of these, more on the crossing, at 1,400-1,600 m (79 %), than before it, at '
         '1,200-1,400 m (16 %)',
         f'{_searches(within(on, end))} at 1,400-1,600 m, '
         f'{_searches(within(before, on))} at 1,200-1,400 m'),
        ('learned_at_start', at_start, 1 - crossing - at_start,
         'of the other starts, more at 0-200 m (5 %) than all others (1 %)',
         f'{_searches(at_start)} at 0-200 m, {_searches(1 - crossing - at_start)} at all others'),
    ):
        higher, lower = int((more > less).sum()), int((more < less).sum())
        yield Claim(
            name=name, source=_RETRAINING, sides=mostly(higher, lower),
            statement=f'{statement}: in most searches',
            evidence=f'{evidence}: in {higher} of {len(found)}.',
        )

# Words -------------------------------------------------------------------------------------------


def _title(name: str) -> str:
    return 'Halton' if name == HALTON else name


def _sky(clouds: str) -> str:
    return 'a clear sky' if clouds == 'clear' else f'{clouds} clouds'


def _fail(network: Network, failed: np.ndarray) -> str:
    return f'{_share(network, failed)} fail' if len(failed) else 'no run was judged'


def _share(network: Network, hits: np.ndarray) -> str:
    """Display text such as ``63.8 % (51.3-75.0) of 69 runs``."""
    if not len(hits):
        return 'no run'
    found = network.share(hits)
    ends = f'{_percent(found.low)}-{_percent(found.high)}'
    return f'{_percent(found.rate)} % ({ends}) of {len(hits):,} runs'


def _median(values: np.ndarray, where: str) -> str:
    return f'{_typical(values)} m under {where} ({len(values)} runs)'


def _typical(values: np.ndarray) -> str:
    return f'{np.median(values):.2f}' if len(values) else 'unknown'


def _searches(shares: np.ndarray) -> str:
    words = f'{_percent(float(shares.mean()))} %'
    if len(shares) == 1:
        return f'{words} (one search)'
    return (
        f'{words} ({_percent(float(shares.min()))} to {_percent(float(shares.max()))} in '
        f'{len(shares)} searches)'
    )


def _pair_words(rates: PairedRates, first: str, second: str, verb: str, place: str) -> str:
    scenes = f'scenes {place}' if place else 'scenes'
    if not rates.pairs:
        return f'no {scenes} were judged with both'
    value, low, high = (100 * part for part in rates.difference)
    return (
        f'of {rates.pairs:,} {scenes} {100 * rates.first / rates.pairs:.1f} % {verb} with the '
        f'{first} network and {100 * rates.second / rates.pairs:.1f} % with the {second} one: '
        f'{value:+.1f} points ({low:+.1f} to {high:+.1f})'
    )


def _percent(share: float, digits: int = 1) -> str:
    return f'{100 * share:.{digits}f}'
