"""What the stages of a study have found, read back from their folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from taxinet_ros.analysis.campaign_runs import CampaignRuns, runs_of
from taxinet_ros.analysis.paired_rates import PairedRates, paired_rates
from taxinet_ros.analysis.settled import settled_cross_track_m
from taxinet_ros.campaign.learned_result import LEARNED_NAME, LearnedResult
from taxinet_ros.campaign.rates import Rate, rate
from taxinet_ros.campaign.search_space import Choice
from taxinet_ros.campaign.table import PARQUET_NAME, read_table
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import load_json
from taxinet_ros.study.config import StudyConfig
from taxinet_ros.study.plan import ANALYZE, LEARN, LOCALIZE, NETWORKS, campaign_of, weights_of

SETTLED_RUNS = 400
"""Bags that are opened for a median: reading all of 4,000 would take minutes for each network."""

_SCENE = ('cross_track_m', 'distance_m', 'heading_deg', 'clouds', 'rain_percent', 'time_of_day_h')


@dataclass(frozen=True, kw_only=True)
class Network:
    """A network that was evaluated.

    Attributes:
        name: of :data:`.plan.NETWORKS`.
        runs: its campaign.
        table: judged runs with all columns of the table, by index.
        card: its model card, empty where there is none.
        settled_m: median |cross-track error| [m] after the first ten seconds, of at most
            :data:`SETTLED_RUNS` runs, evenly spread; NaN where a bag is gone.
    """

    name: str
    runs: CampaignRuns
    table: pd.DataFrame
    card: Mapping[str, Any]
    settled_m: np.ndarray

    @property
    def satisfied(self) -> Rate:
        """Share of the judged runs that satisfy their formula."""
        return share_of(~self.runs.failed)

    @property
    def off_runway(self) -> Rate:
        """Share of the judged runs that leave the runway."""
        return share_of(self.off)

    @property
    def off(self) -> np.ndarray:
        """Which runs left the runway."""
        return self.runs.frame['left_runway'].to_numpy() > 0

    @property
    def unjudged(self) -> int:
        """Number of runs without a verdict: the bench broke them, or no scene was drawn."""
        return sum(self.runs.others.values())

    def within(self, column: str, low: float, high: float) -> np.ndarray:
        """Which runs have a value of a feature in [low, high)."""
        values = self.runs.frame[column].to_numpy()
        return np.asarray((values >= low) & (values < high))


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two networks on the same scenes.

    Attributes:
        first, second: their names; differences are the second's less the first's.
        frame: scenes judged with both: ``distance_m``, and ``satisfied`` and ``off`` of each.
    """

    first: str
    second: str
    frame: pd.DataFrame

    def satisfied(self, among: np.ndarray | None = None) -> PairedRates:
        """How often they satisfy, on all scenes or on some."""
        return self._paired('satisfied', among)

    def off_runway(self) -> PairedRates:
        """How often they leave the runway."""
        return self._paired('off', None)

    def at(self, low: float, high: float) -> np.ndarray:
        """Scenes that start there along the runway [m]."""
        return np.asarray(self.frame['distance_m'].between(low, high, inclusive='left'))

    def _paired(self, name: str, among: np.ndarray | None) -> PairedRates:
        frame = self.frame if among is None else self.frame[among]
        return paired_rates(
            frame[f'{name}_first'].tolist(), frame[f'{name}_second'].tolist()
        )


@dataclass(frozen=True, kw_only=True)
class Results:
    """Everything that is there; what is not done yet is missing.

    Attributes:
        networks: by name, in the study's order.
        learned: distribution of the generic network's failures, or None.
        localized: values of ``localize.json``, or None.
        analysis: values of ``analysis.json``, or None.
        experiments: values of ``experiment.json`` by the experiment's name.
    """

    networks: Mapping[str, Network]
    learned: LearnedResult | None
    localized: Mapping[str, Any] | None
    analysis: Mapping[str, Any] | None
    experiments: Mapping[str, Mapping[str, Any]]

    def pair(self, first: str, second: str) -> Pair | None:
        """Two networks on the scenes that were judged with both; None if one is missing.

        Raises:
            UsageError: they did not have the same scenes.
        """
        if first not in self.networks or second not in self.networks:
            return None
        return _pair(self.networks[first], self.networks[second])

    @property
    def distances(self) -> Choice | None:
        """The choice of where to start along the runway, of what was learned."""
        for choice in self.learned.choices if self.learned else ():
            if 'distance' in choice.feeds and choice.pieces:
                return choice
        return None


def read_results(config: StudyConfig, out: Path) -> Results:
    """Read what is done.

    Raises:
        UsageError: a table or a file is damaged.
    """
    networks = {
        name: _network(name, out) for name in NETWORKS
        if (out / campaign_of(name) / PARQUET_NAME).is_file()
    }
    names = [Path(word).stem for word in config.experiments]
    found = {name: _values(out / f'experiment-{name}' / 'experiment.json') for name in names}
    learned = (out / LEARN / LEARNED_NAME).is_file()
    return Results(
        networks=networks,
        learned=LearnedResult.read(out / LEARN) if learned else None,
        localized=_values(out / LOCALIZE / 'localize.json'),
        analysis=_values(out / ANALYZE / 'analysis.json'),
        experiments={name: values for name, values in found.items() if values is not None},
    )


def _network(name: str, out: Path) -> Network:
    folder = out / campaign_of(name)
    table = read_table(folder)
    runs = runs_of(table, folder)
    judged = table[table['run_id'].isin(runs.frame['run_id'])].sort_values('index')
    card = _values((out / weights_of(name)).with_suffix('.json'))
    ids = judged['run_id'].tolist()
    some = ids[:: max(1, -(-len(ids) // SETTLED_RUNS))]
    return Network(
        name=name, runs=runs, table=judged.reset_index(drop=True), card=card or {},
        settled_m=settled_cross_track_m(folder, some),
    )


def _pair(first: Network, second: Network) -> Pair:
    frames = []
    for network, end in ((first, '_first'), (second, '_second')):
        frame = network.runs.frame[['index', *_SCENE]].copy()
        frame['satisfied'], frame['off'] = ~network.runs.failed, network.off
        frames.append(frame.add_suffix(end).rename(columns={f'index{end}': 'index'}))
    both = frames[0].merge(frames[1], on='index')
    for name in _SCENE:
        if not both[f'{name}_first'].equals(both[f'{name}_second'].rename(f'{name}_first')):
            raise UsageError(
                f'{first.runs.path} and {second.runs.path}: have not the same {name}; evaluate '
                'both networks on one program with one seed'
            )
    return Pair(
        first=first.name, second=second.name,
        frame=both.rename(columns={'distance_m_first': 'distance_m'}),
    )


def _values(path: Path) -> dict[str, Any] | None:
    try:
        values = load_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise UsageError(f'{path}: cannot be read ({error}); do its stage again') from error
    return dict(values)


def share_of(hits: Sequence[bool] | np.ndarray) -> Rate:
    """A share with its 95 % Clopper-Pearson interval."""
    return rate(int(np.count_nonzero(hits)), len(hits))
