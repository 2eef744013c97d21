"""Drive several networks through the same scenes, in the closed loop without ROS.

The scenes are those of a recorded campaign, of a table, of a bag, or fresh draws of a program. Only
the network differs between the runs of a scene, so runs are compared in pairs. Finished runs are
kept in a record: the same command continues after an interrupt, also with more networks.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.bag.layout import holds_bag
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.perception.perception import GroundTruth, check_perception
from taxinet_ros.core.perception.substituted import AS_RECORDED
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.scenario_fields import SCENARIO_FIELDS, is_point
from taxinet_ros.core.system import System, digest_of
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.overrides import scenes_words
from taxinet_ros.scenes.source import Rejected, SceneSource
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.past_runs.recorded_campaign import (
    RecordedCampaign,
    find_run,
    open_campaign,
    spread_evenly,
)
from taxinet_ros.trials.past_runs.trials import Trial, TrialRecord
from taxinet_ros.trials.rates import sample_size_was_fixed
from taxinet_ros.trials.record.facts import is_campaign, recorded_world
from taxinet_ros.trials.record.row import RunRow, rho_column, scene_attributes, specs_of
from taxinet_ros.trials.record.table import read_any_table
from taxinet_ros.trials.record.table import table as table_of
from taxinet_ros.trials.worker_pool import Task


@dataclass(frozen=True, kw_only=True, slots=True)
class Scene:
    """One scene.

    Attributes:
        row: the run that it comes from: name, seed, index, and how it was chosen.
        scenario: the scenario.
        exact: whether it is bit-exact.
    """

    row: RunRow
    scenario: Scenario
    exact: bool

    def task(self, system: System, judging: Judging, word: str = AS_RECORDED) -> Task:
        """The trial of this scene; arguments as of :class:`.Task`."""
        return Task(
            run_id=self.row.run_id, index=self.row.index, program='', seed=self.row.seed,
            scenario=self.scenario, judging=judging, participants=(), system=system, word=word,
            exact=self.exact,
        )


@dataclass(frozen=True, kw_only=True)
class SceneSet:
    """Scenes, and the system that drives them with different networks.

    Attributes:
        source: where they come from, as text.
        scenes: the scenes, by index.
        system: as in the recorded runs, with the truth in place of a network.
        judging: likewise; the first requirement is the headline.
        fixed: whether their number did not depend on any result.
    """

    source: str
    scenes: tuple[Scene, ...]
    system: System
    judging: Judging
    fixed: bool = True

    def system_with(self, network: str) -> System:
        """The system with a network."""
        return dataclasses.replace(self.system, perception=network)

    @property
    def settings(self) -> dict[str, str]:
        """Digests of everything but the network that decides the results."""
        return {
            'system': trials_digest(self.system, self.judging),
            'scenes': digest_of([
                [scene.row.run_id, scene.scenario.recorded_text] for scene in self.scenes
            ]),
        }


def trials_digest(system: System, judging: Judging) -> str:
    """Digest of all that decides the result of a scene. Raises as that of :class:`.System`."""
    return digest_of([system.digest, judging.facts()])


def system_of(campaign: RecordedCampaign) -> System:
    """The system of a campaign, with the truth in place of its network."""
    world, package = recorded_world(campaign.facts)
    return System(
        perception=GroundTruth.word, gains=dict(campaign.gains),
        controller=str(campaign.facts.get('controller', STEERING)),
        timing=parse_timing(campaign.timing), world=world, world_sha256=package,
    )


def scenes_of(path: Path, runs: int | None = None, *, whole: bool = False) -> SceneSet:
    """The scenes of a campaign, of a table, or of one run.

    Args:
        path: folder of a campaign, a ``.parquet`` table, or the bag of a run.
        runs: at most so many, evenly spread over all; None for all.
        whole: whether every requirement is needed, not the headline alone.

    Raises:
        UsageError: it is none of these, or its runs cannot be repeated.
    """
    if is_campaign(path):
        return _of_campaign(path, runs)
    if path.suffix == '.parquet' and path.is_file():
        return _of_table(path, runs, whole=whole)
    if is_campaign(path.parent) or (path.is_dir() and holds_bag(path)):
        return _of_run(path)
    raise UsageError(f'{path}: neither the folder of a campaign, nor a table, nor the bag of a run')


def _of_campaign(path: Path, runs: int | None) -> SceneSet:
    campaign = open_campaign(path)
    system = system_of(campaign)
    if why := system.not_again:
        raise UsageError(f'{path}: {why}, so its scenes cannot be compared')
    if not campaign.judged:
        raise UsageError(f'{path}: no run was judged, so it has no scenes to compare')
    if not campaign.judging.specs:
        raise UsageError(f'{path}: its record does not have the formulas')
    scenes = []
    for row in spread_evenly(campaign.judged, runs):
        scenario, exact = campaign.scenario(row)
        scenes.append(Scene(row=row, scenario=scenario, exact=exact))
    outcomes = {row.index: row.outcome for row in campaign.rows}
    return SceneSet(
        source=str(path), scenes=tuple(scenes),
        system=system, judging=campaign.judging,
        fixed=sample_size_was_fixed(outcomes, campaign.planned_runs),
    )


def _of_table(path: Path, runs: int | None, *, whole: bool) -> SceneSet:
    frame = read_any_table(path)
    names = specs_of(frame.columns) or ['']
    unknown = [name for name in (names if whole else names[:1]) if name not in SHIPPED]
    if unknown:
        raise UsageError(
            f"{path}: a table has no text of its formula {unknown[0]}; name the campaign's folder"
        )
    timings = set(frame['timing'].dropna()) - {''} if 'timing' in frame.columns else set()
    if timings:
        raise UsageError(
            f'{path}: runs with timing {min(timings)}, which a table does not describe in full; '
            "name the campaign's folder"
        )
    outcomes = dict(zip(frame['index'].tolist(), frame['outcome'].tolist(), strict=True))
    judged = frame[frame['outcome'].isin([Outcome.PASS, Outcome.FAIL])].sort_values('index')
    scenes = [
        Scene(row=row, scenario=scenario_from_human(row.scene), exact=False)
        for row in (_row(values, names[0]) for values in judged.to_dict('records'))
    ]
    return SceneSet(
        source=str(path), scenes=spread_evenly(scenes, runs),
        system=System(perception=GroundTruth.word),
        judging=Judging(specs=tuple(
            f'{name}={SHIPPED[name].text}' for name in names if name in SHIPPED)),
        fixed=sample_size_was_fixed(outcomes, None),
    )


def _row(values: Mapping[Any, Any], spec: str) -> RunRow:
    """A row with what a table says of the scene; keys that it lacks have no effect."""
    scene: dict[str, Any] = {}
    usual = Scenario().to_human()
    for known in SCENARIO_FIELDS:
        value = values.get(known.key)
        missing = value is None or value != value or value is pd.NA
        scene[known.key] = usual[known.key] if missing else value
    scene['signals'] = {
        name: value for name, value in values.items() if is_point(name) and not pd.isna(value)
    }
    return RunRow(
        run_id=str(values['run_id']), index=int(values['index']), program=str(values['program']),
        seed=int(values.get('seed', 0)), perception=str(values['perception']),
        outcome=Outcome(values['outcome']), sampler=str(values.get('sampler', '') or ''),
        robustness=exact_intervals({spec: float(values[rho_column(spec)])}), **scene,
    )


def _of_run(path: Path) -> SceneSet:
    run = find_run(path)
    if why := run.not_again:
        raise UsageError(f'{path}: {why}, so it cannot be repeated')
    if run.outcome.judged and not run.robustness:
        raise UsageError(f'{path}: its verdict is not recorded')
    row = RunRow(
        run_id=run.run_id, index=0, program='', seed=run.seed, perception=run.perception,
        outcome=run.outcome if run.outcome.judged else Outcome.INTERRUPTED,
        robustness=run.robustness, **scene_attributes(run.scenario),
    )
    return SceneSet(
        source=str(path), scenes=(Scene(row=row, scenario=run.scenario, exact=True),),
        system=run.alone(perception=GroundTruth.word, controller_sha256=''),
        judging=Judging(specs=run.specs),
    )


def scenes_of_program(
    program: str, *, runs: int, seed: int, judging: Judging, overrides: Mapping[str, str] = {},
) -> SceneSet:
    """Fresh scenes, drawn by the program itself.

    Args:
        program: word or path of a Scenic program.
        runs: number of scenes.
        seed: seed of the scenes.
        judging: the requirement, one.
        overrides: values that replace drawn ones, see :class:`SceneSource`.

    Raises:
        UsageError: the program is invalid, or rejects most of its scenes; or there are several
            requirements.
    """
    headline, *others = judging.names
    if others:
        raise UsageError(f'spec {others[0]}: one requirement here, {headline}; leave this one out')
    scenes: list[Scene] = []
    rejected, name = 0, Path(program).stem
    with SceneSource(program, seed=seed, overrides=overrides) as source:
        while len(scenes) < runs:
            index = len(scenes) + rejected
            try:
                scenario = source.scene(index)
            except Rejected as error:
                rejected += 1
                if rejected > runs:
                    raise UsageError(f'{error}; most scenes are rejected') from None
                continue
            row = RunRow(
                run_id=f'{name}-s{seed}-{index:05d}', index=index,
                program=scenes_words(name, overrides), seed=seed,
                perception='', outcome=Outcome.INTERRUPTED, sampler='random',
                **scene_attributes(scenario),
            )
            scenes.append(Scene(row=row, scenario=scenario, exact=True))
    return SceneSet(
        source=program, scenes=tuple(scenes), system=System(perception=GroundTruth.word),
        judging=judging,
    )


def scenes_of_options(options: CampaignOptions) -> SceneSet:
    """Fresh scenes of the program of options, with the system that they ask for.

    Raises:
        UsageError: as :func:`scenes_of_program`.
    """
    scenes = scenes_of_program(
        options.program, runs=options.runs, seed=options.seed, judging=options.judging,
        overrides=options.overrides,
    )
    return dataclasses.replace(scenes, system=options.alone(
        perception=GroundTruth.word, world_sha256=find_world(options.world).fingerprint,
    ))


class SharedTrials(TrialRecord):
    """Runs of several networks on the same scenes, recorded in a folder. A context manager."""

    def __init__(self, scenes: SceneSet, out: Path) -> None:
        """Open or create the record in ``out``.

        Raises:
            UsageError: it contains something else, or another process uses it.
        """
        super().__init__(out, scenes.settings, 'has runs of other scenes or settings')
        self.scenes = scenes

    def drive(
        self, network: str, wanted: Sequence[str] | None = None, *, workers: int,
        on_trial: Callable[[], None] = lambda: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> dict[str, Trial]:
        """Drive a network through the scenes that it has not been driven through.

        Args:
            network: word or file.
            wanted: names of the scenes; None for all.
            workers: number of processes.
            on_trial: called after each run.
            interrupted: whether to start no more runs.

        Returns:
            Its results so far by name of the scene.

        Raises:
            UsageError: there is no such network.
            InfraError: worker processes end one after the other.
            KeyboardInterrupt: interrupted, with wanted runs left.
        """
        fingerprint, system = check_perception(network), self.scenes.system_with(network)
        self.make({
            f'{fingerprint} {name}': partial(scene.task, system, self.scenes.judging)
            for scene in self.scenes.scenes
            if (name := scene.row.run_id) and (wanted is None or name in wanted)
        }, workers, on_trial, interrupted)
        done = self._results(network)
        names = {scene.row.run_id for scene in self.scenes.scenes} if wanted is None else {*wanted}
        if interrupted() and names - done.keys():
            raise KeyboardInterrupt
        return done

    def _results(self, network: str) -> dict[str, Trial]:
        fingerprint, known = check_perception(network), self.done
        return {
            name: trial for scene in self.scenes.scenes
            if (trial := known.get(f'{fingerprint} {(name := scene.row.run_id)}')) is not None
        }

    def table(self, network: str) -> pd.DataFrame:
        """Results of a network as a campaign's table; runs that were not judged are in it too."""
        return table_of(self.rows(network), self.scenes.judging.names)

    def rows(self, network: str) -> list[RunRow]:
        """Results of a network, by scene; runs that were not judged are among them."""
        fingerprint = check_perception(network)
        spec = self.scenes.judging.headline
        rows: list[RunRow] = []
        results = self._results(network)
        for place, scene in enumerate(self.scenes.scenes):
            if (trial := results.get(scene.row.run_id)) is not None:
                row = _result_row(scene.row, trial, network, fingerprint, spec)
                # Gaps would say that runs are missing; these scenes are all that were asked for.
                row = dataclasses.replace(row, index=place) if self.scenes.fixed else row
                rows.append(row)
        return rows


def _result_row(row: RunRow, trial: Trial, network: str, fingerprint: str, spec: str) -> RunRow:
    known = trial.robustness
    robustness = {} if known is None else {spec: known, **trial.others}
    judged = trial.passed is not None and known is not None
    outcome = Outcome.PASS if trial.passed else Outcome.FAIL
    return dataclasses.replace(
        row, perception=network, fingerprint=fingerprint,
        outcome=outcome if judged else Outcome.INFRA_ERROR,
        kind='' if judged else 'broken', detail='' if judged else trial.detail,
        robustness=robustness if judged else {},
        stopped_early=not all(one.exact for one in robustness.values()), stopped_s=None,
        left_runway=trial.left_runway, max_cross_track_m=trial.max_cross_track_m,
        settle_time_s=trial.settle_time_s, bag='', cte_error_mean_m=None,
        cte_error_mean_abs_m=None, cte_error_max_abs_m=None, he_error_mean_deg=None,
        he_error_mean_abs_deg=None, he_error_max_abs_deg=None, unusable_estimates=None,
        sigma={},
    )
