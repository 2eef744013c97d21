"""Results of the stages of a study, read from their folders."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from taxinet_ros.analysis.experiment.pairs import PairedRates, paired_rates
from taxinet_ros.analysis.runs.campaign import CampaignRuns, Weighting, runs_of
from taxinet_ros.analysis.runs.features import SCENE_COLUMNS
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.perception.weights import weights_path
from taxinet_ros.core.scenario_fields import SHORT_FORMS
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.files.reading import read_file
from taxinet_ros.files.sealed_json import read_sealed
from taxinet_ros.scenes.search_space import Choice
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.plan import (
    ANALYZE,
    BEST,
    ITERATIVE,
    LOCALIZE,
    NETWORKS,
    ORIGINAL,
    campaign_of,
    search_of,
    weights_of,
)
from taxinet_ros.trials.learned_result import LEARNED_NAME, LearnedResult
from taxinet_ros.trials.rates import Rate, rate
from taxinet_ros.trials.record.table import PARQUET_NAME, read_any_table, read_table

LEARNED = 'iterative-verifai'
"""The shipped network that was trained on images of the failures that the paper's rule learned."""
SETTLED_RUNS = 400
"""Number of bags read for a median: reading all 4,000 would take minutes per network."""
SETTLED_AFTER_S = 10.0
"""The ten seconds that phi_eventually gives a run to reach the centreline (paper, section 3.2)."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """An evaluated network.

    Attributes:
        name: one of :data:`.plan.NETWORKS`.
        runs: its campaign.
        table: judged runs with all columns of the table, by index.
        card: its model card, empty if there is none.
        settled_m: median |cross-track error| [m] after the first ten seconds, of at most
            :data:`SETTLED_RUNS` runs, evenly spread; NaN if a bag is missing.
    """

    name: str
    runs: CampaignRuns
    table: pd.DataFrame
    card: Mapping[str, Any]
    settled_m: np.ndarray

    @property
    def satisfied(self) -> Rate:
        """Share of the judged runs that satisfy their formula."""
        return self.share(~self.runs.failed)

    @property
    def off_runway(self) -> Rate:
        """Share of the judged runs that leave the runway."""
        return self.share(self.off)

    def share(self, hits: Sequence[bool] | np.ndarray) -> Rate:
        """A share of some of its runs with its 95 % interval.

        Valid at any time if the number of runs was not fixed beforehand.
        """
        return rate(int(np.count_nonzero(hits)), len(hits), anytime=self.runs.anytime)

    @property
    def off(self) -> np.ndarray:
        """Mask of the runs that left the runway."""
        return self.runs.frame['left_runway'].to_numpy() > 0

    @property
    def unjudged(self) -> int:
        """Number of runs without a verdict: infrastructure errors, or no scene was drawn."""
        return sum(self.runs.others.values())

    def within(self, column: str, low: float, high: float) -> np.ndarray:
        """Mask of the runs with a value of a feature in [low, high)."""
        values = self.runs.frame[column].to_numpy()
        return np.asarray((values >= low) & (values < high))


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two networks on the same scenes.

    Attributes:
        first, second: names; differences are second minus first.
        frame: scenes judged with both: ``distance_m``, and ``satisfied`` and ``off`` of each.
    """

    first: str
    second: str
    frame: pd.DataFrame

    def satisfied(self, among: np.ndarray | None = None) -> PairedRates:
        """Paired rates of satisfaction, on all scenes or on some."""
        return self._paired('satisfied', among)

    def off_runway(self) -> PairedRates:
        """Paired rates of leaving the runway."""
        return self._paired('off', None)

    def at(self, low: float, high: float) -> np.ndarray:
        """Mask of the scenes that start between ``low`` and ``high`` along the runway [m]."""
        return np.asarray(self.frame['distance_m'].between(low, high, inclusive='left'))

    def _paired(self, name: str, among: np.ndarray | None) -> PairedRates:
        frame = self.frame if among is None else self.frame[among]
        return paired_rates(
            frame[f'{name}_first'].tolist(), frame[f'{name}_second'].tolist()
        )


@dataclass(frozen=True, kw_only=True)
class Results:
    """Available results of a study; those of unfinished stages are missing.

    Attributes:
        networks: networks by name, in the study's order.
        searches: learned results of the searches for the generic network's failures, by sampler,
            one per seed.
        localized: values of ``localize.json``, or None.
        analysis: values of ``analysis.json``, or None.
        experiments: values of ``experiment.json`` by the experiment's name.
        experiment_pairs: pairs of runs of these experiments.
    """

    networks: Mapping[str, Network]
    searches: Mapping[str, tuple[LearnedResult, ...]]
    localized: Mapping[str, Any] | None
    analysis: Mapping[str, Any] | None
    experiments: Mapping[str, Mapping[str, Any]]
    experiment_pairs: Mapping[str, pd.DataFrame]

    def pair(self, first: str, second: str) -> Pair | None:
        """Two networks on the scenes judged with both; None if one is missing.

        Raises:
            UsageError: they did not have the same scenes.
        """
        if first not in self.networks or second not in self.networks:
            return None
        return _pair(self.networks[first], self.networks[second])

    @property
    def distances(self) -> Choice | None:
        """Dimension of the start distance along the runway in the learned results."""
        for found in self.searches.values():
            for choice in found[0].choices:
                if 'distance_m' in choice.feeds and choice.pieces:
                    return choice
        return None


def read_results(config: StudyConfig, out: Path) -> Results:
    """Read the results of the finished stages.

    Raises:
        UsageError: a table or a file is damaged.
    """
    networks = {}
    for name in NETWORKS:
        folder = out / campaign_of(name)
        if (folder / PARQUET_NAME).is_file():
            card = (out / weights_of(name)).with_suffix('.json')
            networks[name] = _network(name, folder, card, bags=True)
    names = [Path(word).stem for word in config.experiments]
    folders = {name: out / f'experiment-{name}' for name in names}
    values = {name: _sealed_values(folder / 'experiment.json') for name, folder in folders.items()}
    return Results(
        networks=networks, searches=_searches(config, out),
        localized=_sealed_values(out / LOCALIZE / 'localize.json'),
        analysis=_sealed_values(out / ANALYZE / 'analysis.json'),
        experiments={name: found for name, found in values.items() if found is not None},
        experiment_pairs=_pairs({
            name: folder / 'pairs.parquet' for name, folder in folders.items()
        }),
    )


def read_tables(config: StudyConfig, folder: Path) -> Results:
    """Read results from tables instead of a study's folder, such as those shipped in the package.

    For each network the table with the most runs counts, ``s_falsif_<word>_<runs>.parquet``, with
    ``iterative-verifai`` for the images of the learned failures: what is shipped as
    ``iterative-learned`` was trained on failures that our own rule learned. The table
    of ``truth`` shows whether the network causes the original network's failures. ``experiment_
    <name>.parquet`` has the pairs of an experiment; the searches have folders, as in a study.

    Args:
        config: configuration of the study.
        folder: folder of the tables.

    Raises:
        UsageError: there is no table, or one is damaged or was not drawn at random.
    """
    networks = {}
    for name in NETWORKS:
        word = {BEST: config.best, ITERATIVE[2]: LEARNED}.get(name, name)
        path = _largest(folder, word)
        if path is not None:
            card = weights_path(word).with_suffix('.json')
            networks[name] = _network(name, path, card, bags=False)
    if not networks:
        raise UsageError(f'tables {folder}: has no s_falsif_NETWORK_RUNS.parquet')
    names = [Path(word).stem for word in config.experiments]
    return Results(
        networks=networks, searches=_searches(config, folder),
        localized=_on_truth(networks.get(ORIGINAL), _largest(folder, 'truth')), analysis=None,
        experiments={}, experiment_pairs=_pairs({
            name: folder / f'experiment_{name}.parquet' for name in names
        }),
    )


def _largest(folder: Path, word: str) -> Path | None:
    start, end = f's_falsif_{word}_', '.parquet'
    found = {
        int(runs): path for path in folder.glob(f'{start}*{end}')
        if (runs := path.name.removeprefix(start).removesuffix(end)).isdecimal()
    }
    return found[max(found)] if found else None


def _on_truth(original: Network | None, path: Path | None) -> dict[str, Any] | None:
    """Rerun results of the original network's failures on the true state, as in ``localize``."""
    if original is None or path is None:
        return None
    truth = _network('truth', path, None, bags=False)
    frame = _pair(original, truth).frame
    again = frame[~frame['satisfied_first']]
    passed = original.share(again['satisfied_second'].to_numpy())
    count = len(again)
    shares = {
        'substitution': 'truth', 'judged': count, 'passed': int(again['satisfied_second'].sum()),
        'low': passed.low, 'high': passed.high,
    }
    return {
        'failed': int(original.runs.failed.sum()), 'judged': len(original.table),
        'looked_into': count, 'counted': count, 'sentences': [], 'substitutions': [shares],
    }


def _searches(config: StudyConfig, out: Path) -> dict[str, tuple[LearnedResult, ...]]:
    found = {
        sampler: tuple(
            LearnedResult.read(folder) for seed in config.learning_seeds
            if ((folder := out / search_of(sampler, seed)) / LEARNED_NAME).is_file()
        )
        for sampler in config.samplers
    }
    return {sampler: searches for sampler, searches in found.items() if searches}


def _pairs(paths: Mapping[str, Path]) -> dict[str, pd.DataFrame]:
    # The shipped tables include some from before scene keys had units.
    return {
        name: read_any_table(path).rename(columns=SHORT_FORMS)
        for name, path in paths.items() if path.is_file()
    }


def _network(name: str, path: Path, card: Path | None, *, bags: bool) -> Network:
    """Read a network from a campaign's folder, or from its table."""
    table = read_table(path)
    runs = runs_of(table, path)
    if runs.uncounted:
        raise UsageError(
            f'{path}: {runs.uncounted} of its runs follow one without a result; resume the '
            'campaign to its end'
        )
    if runs.weighting is not Weighting.DRAWN:
        raise UsageError(
            f'{path}: its runs were chosen by a sampler, but a study needs scenes drawn at random; '
            'evaluate with sampler random'
        )
    judged = table[table['run_id'].isin(runs.frame['run_id'])].sort_values('index')
    ids = judged['run_id'].tolist() if bags else []
    some = ids[:: max(1, -(-len(ids) // SETTLED_RUNS))]
    return Network(
        name=name,
        runs=runs,
        table=judged.reset_index(drop=True),
        card=(_json_values(card) if card else None) or {},
        settled_m=settled_cross_track_m(path, some),
    )


def settled_cross_track_m(folder: Path, runs: Iterable[str]) -> np.ndarray:
    """Median |cross-track error| [m] of each run after its first ten seconds, from its bag.

    Args:
        folder: folder of the campaign.
        runs: run ids.

    Returns:
        One value per run; NaN if the bag is missing or damaged, or the run was shorter.

    Raises:
        UsageError: a bag belongs to another run.
    """
    return np.array([_settled_m(folder / run) for run in runs], dtype=np.float64)


def _settled_m(bag: Path) -> float:
    if not bag.is_dir():
        return math.nan
    try:
        recording = open_recording(bag)
        recording.check_is(bag.name)
        trace = recording.columns
    except BagError:
        return math.nan
    late = trace['t_ns'].astype(np.int64) >= SETTLED_AFTER_S * NS_PER_S
    return float(np.median(np.abs(trace['cte_m'][late]))) if late.any() else math.nan


def _pair(first: Network, second: Network) -> Pair:
    one, other = (
        network.runs.scenes.set_index(network.runs.frame['index'].to_numpy())
        .assign(satisfied=~network.runs.failed, off=network.off)
        for network in (first, second)
    )
    common = one.index.intersection(other.index)
    one, other = one.loc[common], other.loc[common]
    for name in SCENE_COLUMNS:
        if not one[name].equals(other[name]):
            raise UsageError(
                f'{first.runs.path} and {second.runs.path}: differ in {name}; evaluate both '
                'networks on one program with one seed'
            )
    return Pair(first=first.name, second=second.name, frame=pd.DataFrame({
        'distance_m': one['distance_m'],
        'satisfied_first': one['satisfied'], 'satisfied_second': other['satisfied'],
        'off_first': one['off'], 'off_second': other['off'],
    }))


def _json_values(path: Path) -> dict[str, Any] | None:
    try:
        values = load_json(read_file(path))
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise UsageError(f'{path}: cannot be read ({error}); repeat its stage') from error
    return dict(values)


def _sealed_values(path: Path) -> dict[str, Any] | None:
    """The values of a sealed file after checking the digests of its tables."""
    if not path.is_file():
        return None
    found = read_sealed(path)
    for name in found.files:
        if (table := path.with_name(name)).is_file():
            found.check_file(table, 'repeat its stage')
    return found.values
