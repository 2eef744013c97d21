"""The stages of an investigation, and the experiments that they run.

Paths in stages are absolute: the stages run in the user's folder, from which a perception or
controller file may have been named.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from taxinet_ros.analysis.causes.region import Interval, Kinds, Region
from taxinet_ros.analysis.explain.counterfactual import Factor, factors, run_factors
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.core.perception.domain import Domain, usual_conditions
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    CAMERA_OFFSETS,
    FAULTS,
    FORM,
    GNSS_FIELDS,
    PUSHING_FIELDS,
    RAIN_CLOUDS,
    split_point,
)
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.overrides import NEEDS
from taxinet_ros.scenes.programs import scenario_program
from taxinet_ros.study.stages.stage import Resume, Stage, analysis_stage, localisation_stage
from taxinet_ros.trials.record.table import PARQUET_NAME
from taxinet_ros.trials.run_command import RunSettings
from taxinet_ros.trials.shrink.algorithm import LEAST_ASKED

ANALYZE, LOCALIZE, SHRINK = 'analyze', 'localize', 'shrink'
RECORDED, TRUTH = 'recorded', 'truth'
MOST_CAUSES = 3
"""Causes that are explained and tested; the others are listed."""
LEAST_BUDGET = 24
_TRIALS = 4
_NEAR_M, _NEAR_ALONG_M, _NEAR_DEG = 0.5, 20.0, 2.0
"""How far fresh scenes start from the start of a single run."""
_TEN_H = 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Budget:
    """How a number of runs is shared out.

    Attributes:
        runs: about how many runs all stages make together.
    """

    runs: int

    def __post_init__(self) -> None:
        if self.runs < LEAST_BUDGET:
            raise UsageError(f'budget {self.runs}: needs to be {LEAST_BUDGET} or more')

    @property
    def localized(self) -> int:
        """Failed runs to drive again; each takes four trials, a third of the budget."""
        return max(2, self.runs // (3 * _TRIALS))

    @property
    def shrunk(self) -> int:
        """Most runs of shrinking, a fifth of the budget."""
        return max(LEAST_ASKED, self.runs // 5)

    def scenes(self, arms: int) -> int:
        """Fresh scenes of each experiment, if all of them have so many arms together."""
        left = self.runs - _TRIALS * self.localized - self.shrunk
        return max(2, left // max(arms, 1))


def explain_name(rank: int) -> str:
    """Folder of the explanation of a cause's worst run."""
    return f'explain-{rank}' if rank else 'explain'


def confirm_name(rank: int) -> str:
    """Folder of the experiment on a cause."""
    return f'confirm-{rank}' if rank else 'confirm'


def analyze_stage(campaign: Path, out: Path, spec: str | None) -> Stage:
    """Stage that finds what failures have in common; replaces an earlier one.

    ``spec`` names the requirement looked into, here and below, if it is not the headline.
    """
    # 3: scenes were chosen by a sampler, so there is no rate.
    return analysis_stage(
        ANALYZE, str(campaign), options={**_named(spec), 'out': out / ANALYZE}, accepts=(0, 3),
    )


def localize_stage(
    campaign: Path, out: Path, *, runs: int, workers: int, perception: str | None,
    spec: str | None,
) -> Stage:
    """Stage that drives failed runs again with perfect estimates."""
    moved = {} if perception is None else {'perception': perception}
    return localisation_stage(
        LOCALIZE, str(campaign), runs=runs, workers=workers,
        options={**moved, **_named(spec), 'out': out / LOCALIZE}, optional=True,
    )


def _named(spec: str | None) -> dict[str, str]:
    return {} if spec is None else {'spec': spec}


def explain_stage(
    bag: Path, out: Path, rank: int, perception: str, world: str, judging: Judging | None
) -> Stage:
    """Stage that explains the errors of the network in one run.

    ``judging`` is how runs are judged, here and below, if not with their headline first.
    """
    name, camera = explain_name(rank), world_and_camera(world)[1]
    seen = {} if camera == OURS else {'camera': camera}
    return Stage(
        name=name, command='explain', argument=str(bag),
        options={
            'perception': perception, **seen, **_named(judging.headline if judging else None),
            'out': out / name,
        },
        inputs=tuple(str(path) for path in storage_files(bag)),
        outputs=(f'{name}/explain.json', f'{name}/explain.html'), optional=True,
    )


def shrink_stage(
    bag: Path, out: Path, *, runs: int, workers: int, perception: str, judging: Judging | None
) -> Stage:
    """Stage that finds the parameters of a run that matter."""
    table = bag.parent / PARQUET_NAME
    inputs = (table,) if table.is_file() else storage_files(bag) if bag.is_dir() else ()
    return Stage(
        name=SHRINK, command='shrink', argument=str(bag), runs=runs, hints={'workers': workers},
        options={
            'perception': perception, **({'spec': judging.specs} if judging else {}),
            'images': 'none', 'quiet': True, 'out': out / SHRINK,
        },
        inputs=tuple(map(str, inputs)), outputs=(f'{SHRINK}/shrink.json',),
        resume=Resume.OPTION, optional=True,
    )


def confirm_stage(
    experiment: Path, out: Path, rank: int, *, scenes: int, workers: int
) -> Stage:
    """Stage that runs the same fresh scenes with and without what is suspected."""
    name = confirm_name(rank)
    return Stage(
        name=name, command='experiment', argument=str(experiment), options={'out': out / name},
        runs=scenes, hints={'workers': workers},
        inputs=(str(experiment), str(_program_of(experiment))),
        outputs=(f'{name}/experiment.json', f'{name}/experiment.html'), accepts=(0, 4),
        resume=Resume.OPTION, optional=True,
    )


def _program_of(experiment: Path) -> Path:
    return Path(yaml.safe_load(experiment.read_text(encoding='utf-8'))['program'])


@dataclass(frozen=True, kw_only=True, slots=True)
class Change:
    """What is suspected, as a change of the scene.

    Attributes:
        words: how the scene then is, such as ``without the crossing``.
        values: scenario values that make it so, in human keys and units.
    """

    words: str
    values: Mapping[str, Any]

    @property
    def arm(self) -> str:
        """Name of the experiment's arm."""
        return re.sub('[^A-Za-z0-9]+', '_', self.words).strip('_')[:40] or 'changed'


def blamed_change(scenario: Scenario, name: str) -> Change | None:
    """The change of a factor that an explanation blames.

    Args:
        scenario: of the explained run.
        name: name of the factor.
    """
    known: dict[str, Factor] = {
        factor.name: factor for factor in (*run_factors(scenario), *factors(scenario))
    }
    if name not in known:
        return None
    before, after = scenario.to_human(), known[name].scenario.to_human()
    values = {key: value for key, value in after.items() if value != before.get(key)}
    # Without its control points, a value stays as it is at the start.
    values |= {
        name: after[split_point(name)[0]] for name in before.keys() - after.keys()
        if split_point(name)[1] != FORM
    }
    return Change(words=known[name].words, values=_possible(values))


def region_change(region: Region) -> Change | None:
    """The change that takes scenes out of a region, if it is one of weather, hour or a fault.

    Where a run starts cannot be changed without making it another run.
    """
    values: dict[str, Any] = {}
    words = []
    absent = {field.key: field for field in (
        *PUSHING_FIELDS, *FAULTS, *CAMERA_OFFSETS, *GNSS_FIELDS)}
    for part in region.parts:
        key, later = split_point(part.feature) if isinstance(part, Interval | Kinds) else ('', '')
        if isinstance(part, Interval) and part.feature == 'rain_percent' and part.low:
            values['rain_percent'] = 0.0
            words.append('dry')
        elif isinstance(part, Interval) and part.feature == 'time_of_day_h':
            values['time_of_day_h'] = _TEN_H
            words.append('at 10:00')
        elif isinstance(part, Kinds) and part.feature == 'clouds' and 'clear' not in part.kinds:
            values['clouds'] = 'clear'
            words.append('under a clear sky')
        elif isinstance(part, Interval | Kinds) and key in absent and later != FORM:
            # Without the drop-out, not with one that starts at 0.
            name = part.feature if later else min(NEEDS.get(key, {key}))
            if name not in values:
                words.append(f'without {BY_KEY[name].title}')
            field = absent[split_point(name)[0]]
            values[name] = field.to_human(field.absent)
    return Change(words=', '.join(words), values=_possible(values)) if values else None


def trained_change(
    domain: Domain | None, scenes: Sequence[Mapping[str, Any]]
) -> Change | None:
    """The change of sky, rain and hour to what a network was trained in, if scenes are outside it.

    Args:
        domain: of the network; None if unknown.
        scenes: values by key in human units.
    """
    usual = {'clouds': 'clear', 'rain_percent': 0.0, 'time_of_day_h': _TEN_H}
    values = _possible(usual_conditions(domain, scenes, usual))
    if not values or (values.get('rain_percent') and 'clouds' not in values):
        return None  # rain needs clouds, which not all of these scenes have
    said = ', '.join(f'{BY_KEY[key].label} {BY_KEY[key].value_words(one)}' for key, one in
                     values.items())
    return Change(words=f'in weather and light of its training ({said})', values=values)


def _possible(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values, dry where the sky that they set cannot rain."""
    dry = 'clouds' in values and values['clouds'] not in RAIN_CLOUDS
    return {**values, **({'rain_percent': 0.0} if dry else {})}


def experiment_text(
    settings: RunSettings, *, program: Path, seed: int, change: Change | None, runs: int,
) -> str:
    """Text of an experiment's file: as recorded, with the change, and with perfect estimates.

    Args:
        settings: settings of the runs; only those that an experiment can have, see
            :func:`why_no_experiment`.
        program: Scenic program of the scenes.
        seed: seed of the scenes.
        change: what is suspected; None for the perfect estimates only.
        runs: number of scenes.
    """
    arms: dict[str, Any] = {RECORDED: {}}
    if change is not None:
        arms[change.arm] = {'set': {key: _plain(value) for key, value in change.values.items()}}
    if settings.perception != TRUTH:
        arms[TRUTH] = {'perception': TRUTH}
    return yaml.safe_dump({
        'program': str(program), 'runs': runs, 'seed': seed, 'perception': settings.perception,
        'controller': settings.controller, 'specs': list(settings.judging.specs),
        'set': settings.texts(), 'arms': arms, 'compare_to': RECORDED,
    }, sort_keys=False, allow_unicode=True)


def _plain(value: Any) -> Any:
    return value if isinstance(value, bool | int | float) else str(value)


def arms_of(change: Change | None, perception: str) -> int:
    """Number of arms of an experiment; one alone compares nothing."""
    return 1 + (change is not None) + (perception != TRUTH)


def why_no_experiment(settings: RunSettings, world: str) -> str:
    """Why runs with these settings cannot be repeated by an experiment; '' if they can."""
    if settings.timing.options:
        return 'an experiment has no latencies, which the runs had'
    if settings.world != world:
        return f'an experiment has no world {settings.world}'
    if settings.judging.bounds or settings.judging.rates:
        return 'an experiment has no assumed bounds or rates, which the runs had'
    return ''


def near_program(scenario: Scenario, run_id: str) -> str:
    """Program of scenes like a run's, that start near its start.

    Args:
        scenario: of the run.
        run_id: its name.
    """
    about = (
        f'Scenes like run {run_id}: they start within {_NEAR_M:g} m across, {_NEAR_ALONG_M:g} m '
        f'along and {_NEAR_DEG:g} degrees of it.'
    )
    lines = scenario_program(scenario, about, {}).rstrip().splitlines()
    human = scenario.to_human()
    right, nose = -float(human['cross_track_m']), float(human['heading_deg'])
    along = float(human['distance_m'])
    first = max(0.0, along - _NEAR_ALONG_M)
    last = min(along + _NEAR_ALONG_M, scenario.line.last_start_m)
    lines[-1] = (
        f'ego = new Plane at ({_span(right - _NEAR_M, right + _NEAR_M)}, {_span(first, last)}), '
        f'facing {_span(nose - _NEAR_DEG, nose + _NEAR_DEG)} deg'
    )
    return '\n'.join([*lines, ''])


def _span(low: float, high: float) -> str:
    return f'Range({low!r}, {high!r})'
