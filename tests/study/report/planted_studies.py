"""Results of studies in which it is known what is true: made up from chances of failing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from taxinet_ros.analysis.runs.campaign import CampaignRuns, Weighting
from taxinet_ros.analysis.runs.features import scene_columns
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.scenes.search_space import Choice, Piece
from taxinet_ros.study.report.results import Network, Results
from taxinet_ros.study.stages.plan import NETWORKS
from taxinet_ros.trials.learned_result import LearnedResult

CLOUDS = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
CHOICE = Choice(
    dimension=Dimension(name='ego.position.y', low=0, high=2000, buckets=10),
    feeds=frozenset({'distance_m'}), pieces=(Piece(start=0, end=1, low=0, high=2000),),
)

ALL = slice(None)

Chances = Callable[[pd.DataFrame], object]
"""Of failing, for each scene."""


def scenes_of(count: int, rng: np.random.Generator) -> pd.DataFrame:
    """Scenes much as of S_falsif; a third of them in rain."""
    return pd.DataFrame({
        'index': np.arange(count), 'weight': 1.0,
        'cross_track_m': rng.uniform(-8, 8, count), 'distance_m': rng.uniform(0, 2000, count),
        'heading_deg': rng.uniform(-30, 30, count), 'clouds': rng.choice(CLOUDS, count),
        'rain_percent': np.where(rng.random(count) < 1 / 3, 50.0, 0.0),
        'time_of_day_h': rng.uniform(6, 18, count),
    })


def planted_study(
    count: int, seed: int, failing: Mapping[str, Chances], *,
    off: Mapping[str, float] | None = None, alike: bool = True, **others: object,
) -> Results:
    """Networks on common scenes.

    Args:
        count: of scenes.
        seed: of everything random.
        failing: chances of the networks.
        off: chance with which a failing run leaves the runway, by network; else 0.5.
        alike: whether one draw decides a scene for all networks, so that of two networks the one
            with the greater chance fails wherever the other does.
        others: attributes of the results.
    """
    rng = np.random.default_rng(seed)
    scenes = scenes_of(count, rng)
    draw, leave, size = (rng.random(count) for _ in range(3))
    networks = {}
    for name in (one for one in NETWORKS if one in failing):
        if not alike:
            draw, leave = rng.random(count), rng.random(count)
        failed = draw < np.broadcast_to(np.asarray(failing[name](scenes), dtype=float), count)
        rho = np.where(failed, -1 - 19 * size, 0.1 + 1.3 * size)
        frame = scenes.assign(
            rho=rho, failed=failed, left_runway=failed & (leave < (off or {}).get(name, 0.5)),
        )
        runs = CampaignRuns(
            label=name, path=Path(name), program='s_falsif', perception=name, sampler='random',
            spec='phi_eventually', facts={}, stacks=(), frame=frame,
            scenes=scene_columns(frame), others={}, kinds={}, undecided=0,
            weighting=Weighting.DRAWN,
        )
        networks[name] = Network(
            name=name, runs=runs, table=frame, card={}, settled_m=np.zeros(0),
        )
    values = {'searches': {}, 'localized': None, 'experiment_pairs': {}, **others}
    return Results(networks=networks, analysis=None, experiments={}, **values)  # type: ignore[arg-type]


def on_truth(passed: int, judged: int) -> dict[str, object]:
    """What ``taxinet localize`` says of so many runs."""
    share = {'substitution': 'truth', 'passed': passed, 'judged': judged, 'low': 0.0, 'high': 1.0}
    return {'substitutions': [share]}


def shadow_pairs(
    with_shadow: np.ndarray, without: np.ndarray, some: slice = ALL
) -> dict[str, pd.DataFrame]:
    """Some of the pairs of the experiment, evenly over the day from 6 to 18 h."""
    hours = np.linspace(6.01, 17.99, len(without))
    return {'shadows': pd.DataFrame({
        'time_of_day_h': hours[some], 'rho_shadows': with_shadow[some],
        'rho_no_shadows': without[some],
    })}


def searches(*distances: tuple[float, ...]) -> dict[str, tuple[LearnedResult, ...]]:
    """Searches by the paper's rule that came to these distributions over ten bins of 200 m."""
    return {'ce-verifai': tuple(
        LearnedResult(facts={}, choices=(CHOICE,), probabilities={'ego.position.y': one})
        for one in distances
    )}


def bins(before: float, on: float, start: float | None = None) -> tuple[float, ...]:
    """A distribution with so much at 1,200-1,400, 1,400-1,600 and 0-200 m, the rest evenly."""
    rest = (1 - before - on) / 8 if start is None else (1 - before - on - start) / 7
    return tuple([rest if start is None else start] + [rest] * 5 + [before, on] + [rest] * 2)
