"""Accuracy of finding causes, on tables whose causes are known.

Scenes are drawn or chosen by one of our samplers from a space like that of S_falsif. Each fails at
random with a probability that depends on the scene, so the causes and their failure rates are
known. The printed table says how often causes are named where there are none, how often one is
found where there is one, and how often the printed intervals contain the true value. The same seed
gives the same table.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from common import count, leave, one_of

import numpy as np
import pandas as pd

from taxinet_ros.analysis.causes.causes import find_causes
from taxinet_ros.analysis.runs.campaign import CampaignRuns, runs_of
from taxinet_ros.analysis.runs.features import Floats
from taxinet_ros.core.scenario_fields import CLOUDS
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.space import Dimension

SPACE = (
    Dimension(name='time_of_day_h'), Dimension(name='clouds', weights=(1.0,) * 6),
    Dimension(name='wet', weights=(1.0, 1.0)), Dimension(name='rain_percent'),
    Dimension(name='cross_track_m'), Dimension(name='distance_m'), Dimension(name='heading_deg'),
)
DAY, NIGHT = (6.0, 18.0), (0.0, 24.0)

_WEIGHTY = 20_000
"""Number of scenes from which the true rate of a region is computed."""


@dataclass(frozen=True, kw_only=True)
class Landscape:
    """Failure probability of each scene.

    Attributes:
        rate: failure probability of each scene in a table.
        hours: range of the time of day.
    """

    rate: Callable[[pd.DataFrame], Floats]
    hours: tuple[float, float] = DAY


def _either(low: float, high: float, where: pd.Series[bool]) -> Floats:
    chance: Floats = np.where(where, high, low)
    return chance


LANDSCAPES: Mapping[str, Landscape] = {
    'no cause, 2 %': Landscape(rate=lambda t: np.full(len(t), 0.02)),
    'no cause, 20 %': Landscape(rate=lambda t: np.full(len(t), 0.2)),
    'no cause, 50 %': Landscape(rate=lambda t: np.full(len(t), 0.5)),
    'strong band': Landscape(
        rate=lambda t: _either(0.05, 0.8, t['distance_m'].between(1200, 1600))),
    'weak band': Landscape(rate=lambda t: _either(0.1, 0.25, t['distance_m'].between(800, 1500))),
    'interaction, numbers': Landscape(
        rate=lambda t: _either(0.1, 0.6, (t['distance_m'] > 1000) & (t['heading_deg'] > 0))),
    'interaction, clouds': Landscape(
        rate=lambda t: _either(
            0.1, 0.6, t['clouds'].isin(CLOUDS[3:]) & (t['time_of_day_h'] < 12))),
    'either, not both': Landscape(
        rate=lambda t: _either(0.1, 0.5, (t['distance_m'] > 1000) ^ (t['heading_deg'] > 0))),
    'diagonal': Landscape(
        rate=lambda t: _either(
            0.1, 0.6, (t['cross_track_m'] / 16 - t['heading_deg'] / 60).abs() < 0.1)),
    'night over midnight': Landscape(
        rate=lambda t: _either(
            0.1, 0.5, (t['time_of_day_h'] > 21.5) | (t['time_of_day_h'] < 3)), hours=NIGHT),
}
"""Landscapes by name; those with 'no cause' in it have none."""


def scenes(points: Floats, hours: tuple[float, float] = DAY) -> pd.DataFrame:
    """The scenes at quantiles of :data:`SPACE`, (runs, 7)."""
    time, clouds, wet, rain, cross_track, distance, heading = points.T
    sky = np.array(CLOUDS)[np.minimum((6 * clouds).astype(int), 5)]
    rains = (wet > 0.5) & np.isin(sky, CLOUDS[3:])
    return pd.DataFrame({
        'cross_track_m': 16 * cross_track - 8, 'distance_m': 2000 * distance,
        'heading_deg': 60 * heading - 30, 'clouds': sky,
        'rain_percent': np.where(rains, 25 + 75 * rain, 0.0),
        'time_of_day_h': hours[0] + (hours[1] - hours[0]) * time,
    })


def searched(sampler: str, runs: int, seed: int, landscape: Landscape) -> CampaignRuns:
    """Runs of a search of a landscape, in the form that an analysis reads."""
    rng = np.random.default_rng([7, seed])
    search = make_sampler(sampler, SPACE, seed, runs)
    points = np.zeros((runs, len(SPACE)))
    rho = np.zeros(runs)
    size = rng.uniform(0.01, 1.0, runs)
    coins = rng.random(runs)
    for _ in range(runs):
        index, point = search.next()
        points[index] = point
        scene = scenes(points[index:index + 1], landscape.hours)
        fails = coins[index] < landscape.rate(scene)[0]
        rho[index] = -20 * size[index] if fails else 1.5 * size[index]
        search.tell(index, float(rho[index]))
    table = scenes(points, landscape.hours)
    weight = [search.weight(index) for index in range(runs)]
    table = table.assign(
        run_id=[f'r{number}' for number in range(runs)], index=np.arange(runs), program='planted',
        perception='network', sampler=sampler, weight=np.array(weight, dtype=np.float64),
        outcome=np.where(rho <= 0, 'FAIL', 'PASS'), rho=rho, rho_phi=rho, date='2020-03-20',
        aircraft='caravan', shadows=True,
    )
    return runs_of(table, Path('planted.parquet'))


@dataclass
class Score:
    """Results over many tables of one kind.

    Attributes:
        tables, named: number of tables, and of those in which a cause was found.
        holds: for each table with a cause, whether the intervals of the first cause's rate, of the
            rate elsewhere and of the associated share contain the true value.
        excess: rate of the first cause minus the true one, for each table with a cause.
        width: width of the interval of its rate.
    """

    tables: int = 0
    named: int = 0
    holds: list[tuple[bool, bool, bool]] = field(default_factory=list)
    excess: list[float] = field(default_factory=list)
    width: list[float] = field(default_factory=list)

    def cells(self) -> list[str]:
        """Cells of the printed table."""
        share = f'{100 * self.named / self.tables:.1f} % of {self.tables}'
        if not self.holds:
            return [share, *[''] * 5]
        held = [f'{100 * part:.0f} %' for part in np.mean(self.holds, axis=0)]
        return [share, *held, f'{100 * float(np.mean(self.excess)):+.0f}',
                f'{100 * float(np.mean(self.width)):.0f}']


def measure(name: str, sampler: str, runs: int, tables: int, seed: int = 0) -> Score:
    """Search for causes in many tables of one kind.

    Args:
        name: key of :data:`LANDSCAPES`.
        sampler: sampler that chooses the scenes.
        runs: number of runs in each table.
        tables: number of tables.
        seed: seed of the first table.
    """
    landscape, score = LANDSCAPES[name], Score()
    rng = np.random.default_rng(99)
    every = scenes(rng.random((_WEIGHTY, len(SPACE))), landscape.hours)
    chance = landscape.rate(every)
    features = every.assign(
        abs_cross_track_m=every['cross_track_m'].abs(), abs_heading_deg=every['heading_deg'].abs())
    for number in range(seed, seed + tables):
        found = find_causes(searched(sampler, runs, number, landscape)).found
        score.tables += 1
        score.named += bool(found)
        if not found or np.isnan(found[0].inside.low):
            continue
        first = found[0]
        inside = first.region.mask(features)
        if not inside.any() or inside.all():
            continue
        true, beyond = float(chance[inside].mean()), float(chance[~inside].mean())
        goes_with_it = 1 - beyond / float(chance.mean())
        _, low, high = first.associated
        score.holds.append((
            first.inside.low <= true <= first.inside.high,
            first.outside.low <= beyond <= first.outside.high,
            low - 1e-9 <= goes_with_it <= high + 1e-9,
        ))
        score.excess.append(first.inside.rate - true)
        score.width.append(first.inside.high - first.inside.low)
    return score


def lines(
    landscapes: Sequence[str], samplers: Sequence[str], runs: Sequence[int], tables: int
) -> Iterator[str]:
    """Yield the lines of a Markdown table as they are computed."""
    yield ('| landscape | sampler | runs | a cause is named | its rate is in its interval | '
           'elsewhere | what goes with it | its rate is off by [points] | width [points] |')
    yield '| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |'
    for name in landscapes:
        for sampler in samplers:
            for number in runs:
                cells = measure(name, sampler, number, tables).cells()
                yield f'| {name} | {sampler} | {number:,} | {" | ".join(cells)} |'


def main(words: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n\n')[0])
    parser.add_argument(
        '--landscapes', nargs='+', type=one_of(LANDSCAPES), default=list(LANDSCAPES))
    parser.add_argument('--samplers', nargs='+', type=one_of(list(SAMPLERS)), default=['random'])
    parser.add_argument('--runs', nargs='+', type=count, default=[100, 400, 2000])
    parser.add_argument('--tables', type=count, default=200)
    given = parser.parse_args(words)
    for line in lines(given.landscapes, given.samplers, given.runs, given.tables):
        print(line, flush=True)
    return 0


if __name__ == '__main__':
    leave(main)
