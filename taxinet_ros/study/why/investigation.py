"""Find out why a campaign or a run failed: run the stages, read their results, collect evidence."""

from __future__ import annotations

import contextlib
import json
import shlex
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.analysis.causes.program import (
    ANOTHER_SEED,
    fresh_seed,
    fresh_settings,
    scenes_program,
    why_no_program,
    write_scenes_program,
)
from taxinet_ros.analysis.causes.region import Region, part_of
from taxinet_ros.analysis.fault_localisation import Blame
from taxinet_ros.analysis.report.text import sentences
from taxinet_ros.analysis.runs.campaign import CampaignRuns, read_examined, read_runs
from taxinet_ros.analysis.runs.features import BY_NAME
from taxinet_ros.analysis.search.shrinking import TEXT
from taxinet_ros.bag.layout import holds_bag
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.mtl import Reading
from taxinet_ros.core.mtl.lint import UNSATISFIABLE
from taxinet_ros.core.perception.domain import Domain, domain_doubts
from taxinet_ros.core.perception.perception import (
    GroundTruth,
    check_perception,
    find_domain,
    network_elsewhere,
)
from taxinet_ros.core.perception.substituted import AS_RECORDED
from taxinet_ros.core.perception.substituted import TRUTH as WITH_TRUTH
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import AIRCRAFT_MODEL, BY_KEY, CAMERA, CAMERA_OFFSETS
from taxinet_ros.core.verdict.judge import describe_specs
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import read_sealed
from taxinet_ros.registry import KMWH
from taxinet_ros.scenes.overrides import overrides_statement
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.study.stages.stage import Stage
from taxinet_ros.study.why.plan import (
    ANALYZE,
    LOCALIZE,
    MOST_CAUSES,
    RECORDED,
    SHRINK,
    TRUTH,
    Budget,
    Change,
    analyze_stage,
    arms_of,
    blamed_change,
    confirm_name,
    confirm_stage,
    experiment_text,
    explain_name,
    explain_stage,
    localize_stage,
    near_program,
    region_change,
    shrink_stage,
    trained_change,
    why_no_experiment,
)
from taxinet_ros.study.why.verdict import (
    TRAINED,
    Blames,
    CauseEvidence,
    Evidence,
    Paired,
    adjusted,
)
from taxinet_ros.trials.loop_run import Loop
from taxinet_ros.trials.past_runs.localisation import make_localize_options
from taxinet_ros.trials.past_runs.recorded_campaign import (
    JudgedRun,
    RecordedCampaign,
    check_unchanged,
    find_run,
    open_campaign,
)
from taxinet_ros.trials.past_runs.trials import Trial
from taxinet_ros.trials.record.facts import is_campaign, recorded_world
from taxinet_ros.trials.record.table import PARQUET_NAME
from taxinet_ros.trials.run_command import RunSettings
from taxinet_ros.trials.worker_pool import Task

CONFIRM, CAUSES, EXPLAIN = 'confirm', 'causes', 'explain'
_RIG = (AIRCRAFT_MODEL, CAMERA, *CAMERA_OFFSETS)
_PROGRAM, _BASE = 'scenes.scenic', 'training.scenic'
_NO_TRUTH = 'the runs were driven by the truth, so there is no network to examine'

RunStages = Callable[[Sequence[Stage]], Mapping[str, str]]
"""Runs the unfinished ones of some stages; why some were refused."""


@dataclass(frozen=True, kw_only=True)
class Investigation:
    """What is asked, and how.

    Attributes:
        path: folder of a campaign, or the bag of a run; absolute.
        out: existing folder of the results; absolute.
        perception: word or file of the network, if it has moved; None for the recorded one.
        spec: name of the requirement to look into; None to choose it.
        budget: runs to be made.
        workers: processes.
        run_stages: runs stages.
    """

    path: Path
    out: Path
    perception: str | None
    budget: Budget
    workers: int
    run_stages: RunStages
    spec: str | None = None

    def evidence(self) -> Evidence:
        """Run what is not done, and collect the evidence.

        Raises:
            UsageError: there is nothing of which to say why it failed.
            StoppedError: a stage was interrupted or broke.
        """
        if kind_of(self.path) == 'run':
            run = find_run(self.path)
            return _with_domain(self._run(run), [run.scenario.to_human()])
        found = self._campaign(open_campaign(self.path))
        scenes: Any = (
            read_runs(self.path, found.spec).scenes.to_dict('records') if found.failed else ())
        return _with_domain(found, scenes)

    @property
    def _command(self) -> str:
        """The command that looks into the subject."""
        near = str(self.path).removeprefix(f'{Path.cwd()}/')
        return f'taxinet why {shlex.quote(near)}'

    # A campaign ----------------------------------------------------------------------------------

    def _campaign(self, campaign: RecordedCampaign) -> Evidence:
        facts = campaign.facts
        if not campaign.judged:
            return Evidence(
                subject=str(self.path), network=str(facts.get('perception', '')),
                controller=str(facts.get('controller', '')), spec='', judged=0, failed=0,
                others=_outcomes(campaign),
            )
        if not (self.path / PARQUET_NAME).is_file():
            raise UsageError(
                f'{self.path}: it has no {PARQUET_NAME}; wait for its end, or resume it'
            )
        runs = read_examined(self.path, self.spec)
        examined = runs.examined
        assert examined is not None
        added = campaign.content.added
        text = f'{runs.spec}={added[runs.spec]}' if runs.spec in added else runs.spec
        judging = campaign.judging.headed_by(text)
        other = None if runs.spec == campaign.judging.headline else runs.spec
        network = self.perception or str(facts.get('perception', ''))
        found = replace(
            _of_runs(runs, subject=str(self.path)), others=_outcomes(campaign), network=network,
            formula=str(facts.get('specs', {}).get(runs.spec, '')),
            chosen=examined.chosen, also=examined.also(self._command),
        )
        found = replace(self._with_scenes(found, runs), base=self._base(runs.scenes))
        if not found.failed:
            return found
        stages = [analyze_stage(self.path, self.out, other)]
        troubles: dict[str, str] = {}
        try:
            make_localize_options(
                self.path, runs=self.budget.localized, words=(), workers=self.workers, out=None,
                perception=self.perception, spec=other,
            )
            stages.append(localize_stage(
                self.path, self.out, runs=min(self.budget.localized, found.failed),
                workers=self.workers, perception=self.perception, spec=other,
            ))
        except UsageError as error:
            troubles[LOCALIZE] = str(error)
        troubles |= self.run_stages(stages)
        if why_not := self._analysis()['causes_why_not']:
            troubles[CAUSES] = str(why_not)
        blames = None if LOCALIZE in troubles else self._blames(campaign, judging)
        causes = self._causes()
        if LOCALIZE in troubles:
            troubles[EXPLAIN] = troubles[CONFIRM] = troubles[LOCALIZE]
        else:
            causes = self._looked_into(
                causes, self.path / causes[0].run_id, network, recorded_world(facts)[0], blames,
                troubles, None if other is None else judging,
            )
            scenes: Any = runs.scenes.to_dict('records')
            causes = self._tested(
                found, why_no_program(runs), causes, troubles,
                trained_change(_domain_of(network), scenes),
            )
        return replace(
            found, blames=blames, causes=causes, troubles=troubles, shrunk=self._shrunk(),
            features=self._features(),
            unsatisfiable=unsatisfiable(
                campaign.scenario((campaign.counterexamples or campaign.judged)[0])[0],
                _first(judging), dict(campaign.gains),
            ),
        )

    def _with_scenes(self, found: Evidence, runs: CampaignRuns) -> Evidence:
        """The evidence with a program of scenes like those of the runs, if it can be written."""
        if why_no_program(runs):
            return found
        path = self.out / _PROGRAM
        write_scenes_program(runs, scenes_program(runs), path)
        return replace(
            found, scenes=path, seed=fresh_seed(runs),
            settings=replace(fresh_settings(runs), perception=found.network),
        )

    def _base(self, scenes: pd.DataFrame) -> Path | None:
        """Write a program of the whole world as the runs' rig sees it; None for the usual one."""
        usual = Scenario().to_human()
        given = {field.key: set(scenes[field.key]) for field in _RIG}
        rig = {
            key: values.pop() for key, values in given.items()
            if len(values) == 1 and values != {usual[key]}
        }
        if not rig:
            return None
        path = self.out / _BASE
        source = find_program(TRAINED).read_text(encoding='utf-8')
        write_atomically(path, f'{source}\n{overrides_statement(rig)}')
        return path

    def _causes(self) -> tuple[CauseEvidence, ...]:
        """The causes that the analysis found; all failures as one if it found none."""
        frame = pd.read_parquet(self.out / ANALYZE / PARQUET_NAME)
        failures = frame[frame['failed']].sort_values(['rho', 'index'], kind='stable')
        found = []
        for cause in self._analysis()['causes']:
            program = self.out / ANALYZE / f'cause-{cause["rank"]}.scenic'
            found.append(self._worst(failures[failures['cause'] == cause['rank']],
                CauseEvidence(
                    rank=cause['rank'], words=cause['words'], inside=_inside_words(cause),
                    program=program if program.is_file() else None,
                )))
        if not found:
            found.append(self._worst(failures, CauseEvidence(rank=0, words='all failures')))
        return tuple(found)

    def _worst(
        self, failures: pd.DataFrame, cause: CauseEvidence
    ) -> CauseEvidence:
        """The cause with its worst run, the worst with a bag if there is one."""
        for run_id, bag in zip(failures['run_id'], failures['bag'], strict=True):
            folder = self.path / bag
            if bag and holds_bag(folder):
                return replace(cause, run_id=str(run_id), bag=folder)
        first = '' if failures.empty else str(failures['run_id'].iloc[0])
        return replace(cause, run_id=first)

    def _analysis(self) -> Mapping[str, Any]:
        return read_sealed(self.out / ANALYZE / 'analysis.json').values

    def _features(self) -> str:
        """Features of the scenes that tell whether a run fails, the most telling first; ''."""
        found = self._analysis()
        telling = [one['feature'] for one in found['ranking'] if one['p'] <= found['alpha']]
        return ' and '.join(BY_NAME[name].title for name in telling[:2])

    def _blames(self, campaign: RecordedCampaign, judging: Judging) -> Blames:
        """The trials by what is at fault; those of the controller by their first sample."""
        cases = pd.read_parquet(self.out / LOCALIZE / 'localize.parquet')
        number = Counter(cases['blame'].tolist())
        rows = {row.run_id: row for row in campaign.counterexamples}
        world = find_world(*recorded_world(campaign.facts)).make
        doomed = sum(
            violated_at_start(campaign.scenario(rows[run_id])[0], _first(judging), world)
            for run_id in cases.loc[cases['blame'] == Blame.CONTROLLER.value, 'run_id']
        )
        return Blames(
            network=number[Blame.PERCEPTION.value],
            controller=number[Blame.CONTROLLER.value] - doomed, requirement=doomed,
            unknown=number[Blame.NOT_REPRODUCED.value] + number[Blame.UNKNOWN.value],
        )

    def _looked_into(
        self, causes: Sequence[CauseEvidence], worst: Path, network: str, world: str,
        blames: Blames | None, troubles: dict[str, str], other: Judging | None,
    ) -> tuple[CauseEvidence, ...]:
        """Explain the worst run of the first causes, and shrink the worst of the first.

        ``other`` is how runs are judged if another requirement than their headline comes first.
        """
        stages = []
        first = causes[:MOST_CAUSES]
        if network == TRUTH:
            troubles[EXPLAIN] = _NO_TRUTH
        elif not any(cause.bag for cause in first):
            troubles[EXPLAIN] = f'no bag of a failed run is left in {self.path}'
        else:
            stages += [
                explain_stage(cause.bag, self.out, cause.rank, network, world, other)
                for cause in first if cause.bag is not None
            ]
        if first[0].run_id:
            # What the truth cannot master is shrunk with the truth.
            alone = blames is not None and not blames.network and blames.counted
            stages.append(shrink_stage(
                worst, self.out, runs=self.budget.shrunk, workers=self.workers,
                perception=TRUTH if alone else network, judging=other,
            ))
        troubles |= self.run_stages(stages)
        return (*(self._explained(cause) for cause in first), *causes[MOST_CAUSES:])

    def _explained(self, cause: CauseEvidence) -> CauseEvidence:
        path = self.out / explain_name(cause.rank) / 'explain.json'
        if cause.bag is None or not path.is_file():
            return cause
        values = json.loads(path.read_text(encoding='utf-8'))
        blamed = {one['name']: one for one in values['factors']}.get(values['blamed'])
        return replace(
            cause, explained=str(values['sentences'][0]),
            blamed='' if blamed is None else str(blamed['words']),
            removed=0.0 if blamed is None else float(blamed['removed']),
        )

    def _change(self, cause: CauseEvidence) -> Change | None:
        """What is suspected: what the explanation blames, else what the region says."""
        path = self.out / explain_name(cause.rank) / 'explain.json'
        if cause.bag is not None and path.is_file():
            name = json.loads(path.read_text(encoding='utf-8'))['blamed']
            found = None if name is None else blamed_change(
                open_recording(cause.bag).scenario, str(name))
            if found is not None:
                return found
        if not cause.rank:
            return None
        parts = next(
            one['region'] for one in self._analysis()['causes'] if one['rank'] == cause.rank)
        return region_change(Region(parts=tuple(map(part_of, parts))))

    def _tested(
        self, found: Evidence, why_not: str, causes: Sequence[CauseEvidence],
        troubles: dict[str, str], trained: Change | None,
    ) -> tuple[CauseEvidence, ...]:
        """Test the first causes on fresh scenes; all failures by the network's training."""
        if found.settings is None or found.scenes is None:
            troubles[CONFIRM] = why_not
            return tuple(causes)
        causes = [replace(cause, program=cause.program or found.scenes) for cause in causes]
        if why := why_no_experiment(found.settings, KMWH):
            troubles[CONFIRM] = why
            return tuple(causes)
        return self._experiments(
            causes, found.settings.headed_by(found.spec, alone=True), seed=found.seed,
            troubles=troubles, trained=trained,
        )

    def _experiments(
        self, causes: Sequence[CauseEvidence], settings: RunSettings, *, seed: int,
        troubles: dict[str, str], trained: Change | None = None,
    ) -> tuple[CauseEvidence, ...]:
        """Run an experiment for each of the first causes, and read the results."""
        first = causes[:MOST_CAUSES]
        changes = {
            cause.rank: trained if trained and not cause.rank else self._change(cause)
            for cause in first
        }
        arms = {rank: arms_of(change, settings.perception) for rank, change in changes.items()}
        arms = {rank: number for rank, number in arms.items() if number > 1}
        if not arms:
            troubles[CONFIRM] = 'nothing is suspected that an experiment could change'
        scenes = self.budget.scenes(sum(arms.values()))
        stages = []
        for cause in first:
            if cause.rank not in arms or cause.program is None:
                continue
            file = self.out / f'{confirm_name(cause.rank)}.yaml'
            write_atomically(file, experiment_text(
                settings, program=cause.program, seed=seed, change=changes[cause.rank],
                runs=scenes,
            ))
            stages.append(confirm_stage(
                file, self.out, cause.rank, scenes=scenes, workers=self.workers))
        refused = self.run_stages(stages)
        troubles |= refused
        if refused and CONFIRM not in troubles:
            troubles[CONFIRM] = next(iter(refused.values()))
        tested = [
            self._compared(cause, changes[cause.rank]) if cause.rank in arms else cause
            for cause in first
        ]
        return (*adjusted(tested), *causes[MOST_CAUSES:])

    def _compared(self, cause: CauseEvidence, change: Change | None) -> CauseEvidence:
        path = self.out / confirm_name(cause.rank) / 'experiment.json'
        if not path.is_file():
            return cause
        values = read_sealed(path).values
        found = {one['arm']: one for one in values['comparisons'] if one['pairs']}
        counts = values['arms'][RECORDED]
        failed, passed = counts.get(Outcome.FAIL.value, 0), counts.get(Outcome.PASS.value, 0)
        return replace(
            cause, fresh=(failed, failed + passed),
            without=None if change is None else _paired(found.get(change.arm), change.words),
            truth=_paired(found.get(TRUTH), 'with perfect estimates'),
        )

    def _shrunk(self) -> tuple[str, ...]:
        path = self.out / SHRINK / 'shrink.json'
        if not path.is_file():
            return ()
        values = json.loads(path.read_text(encoding='utf-8'))
        return sentences(TEXT, 'summary', values=values, fields=BY_KEY)

    # A run ---------------------------------------------------------------------------------------

    def _run(self, run: JudgedRun) -> Evidence:
        network = self.perception or run.perception
        examined = run.examine(self.spec)
        spec = examined.spec
        texts = dict(text.partition('=')[::2] for text in run.specs)
        failed = run.outcome is Outcome.FAIL and (
            not run.robustness or run.robustness[spec].failed)
        found = Evidence(
            subject=str(self.path), network=network, controller=run.controller, spec=spec,
            formula=texts.get(spec, ''), judged=int(run.outcome.judged),
            failed=int(failed), single=True, chosen=examined.chosen,
            also=examined.also(self._command),
            others={} if run.outcome.judged else {str(run.outcome): 1},
            rate='a single run has no rate',
        )
        if not failed:
            return found
        troubles: dict[str, str] = {}
        bag = self.path if holds_bag(self.path) else None
        cause = CauseEvidence(rank=0, words='this run', run_id=run.run_id, bag=bag)
        judging = Judging(specs=run.specs).headed_by(spec)
        blames = None
        try:
            blames = self._trial_blames(run, network, judging)
        except (UsageError, InfraError) as error:
            troubles[LOCALIZE] = troubles[EXPLAIN] = troubles[CONFIRM] = str(error)
        if blames is not None:
            cause, = self._looked_into([cause], self.path, network, run.world, blames, troubles,
                None if spec == run.headline else judging)
            program = self.out / _PROGRAM
            write_atomically(program, near_program(run.scenario, run.run_id))
            settings = RunSettings(
                perception=network, controller=run.controller, gains=run.gains, world=run.world,
                judging=judging, timing=run.timing,
            )
            cause = replace(cause, program=program)
            found = replace(
                found, scenes=program, settings=settings, seed=run.seed + ANOTHER_SEED,
                base=self._base(pd.DataFrame([run.scenario.to_human()])),
            )
            if why := why_no_experiment(settings, KMWH):
                troubles[CONFIRM] = why
            else:
                cause, = self._experiments(
                    [cause], settings.headed_by(spec, alone=True), seed=found.seed,
                    troubles=troubles)
        return replace(
            found, blames=blames, causes=(cause,), troubles=troubles, shrunk=self._shrunk(),
            unsatisfiable=unsatisfiable(run.scenario, _first(judging), dict(run.gains)),
        )

    def _trial_blames(self, run: JudgedRun, network: str, judging: Judging) -> Blames:
        """Drive a run again unchanged, and with perfect estimates."""
        if why := run.not_again:
            raise UsageError(why)
        check_unchanged(
            'perception', network, lambda: check_perception(network), run.fingerprint,
            'name its file as perception',
        )
        check_unchanged(
            'controller', run.controller, lambda: check_controller(run.controller, run.gains),
            run.controller_sha256, 'put its file back',
        )
        system = run.alone(perception=network, controller_sha256='')
        spec, loop = judging.headline, Loop()

        def trial(word: str) -> Trial:
            task = Task(
                run_id=run.run_id, index=0, program='', seed=run.seed, scenario=run.scenario,
                judging=judging, participants=(), system=system, word=word,
            )
            return Trial.of(task, loop.run(task)).about(spec)

        control = trial(AS_RECORDED)
        before = run.robustness.get(spec)
        if control.passed is not False or (before is not None and control.robustness != before):
            return Blames(unknown=1)
        passed = trial(WITH_TRUTH).passed
        if passed is None:
            return Blames(unknown=1)
        if passed:
            return Blames(network=1)
        world = find_world(run.world, run.world_sha256).make
        doomed = violated_at_start(run.scenario, _first(judging), world)
        return Blames(requirement=int(doomed), controller=int(not doomed))



def kind_of(path: Path) -> str:
    """Whether a path is a ``campaign`` or a ``run``.

    Raises:
        UsageError: it is none of them.
    """
    if is_campaign(path):
        return 'campaign'
    if is_campaign(path.parent) or (path.is_dir() and holds_bag(path)):
        return 'run'
    if path.is_dir():
        bags = sorted(one.name for one in path.iterdir() if one.is_dir() and holds_bag(one))
        if bags:
            raise UsageError(
                f'{path}: bags without the {RECORD_NAME} of a campaign; name one of the runs, as '
                f'{path / bags[0]}'
            )
    raise UsageError(f'{path}: neither the folder of a campaign nor the bag of a run')


def _first(judging: Judging) -> Judging:
    """The first requirement alone."""
    return replace(judging, specs=judging.specs[:1])


def violated_at_start(scenario: Scenario, judging: Judging, make_world: Any) -> bool:
    """Whether a formula is violated for certain at the first sample, whatever comes after it.

    No perception, controller or aircraft has had any influence then. Assumptions of the user are
    not used, as they are about the controller too.

    Args:
        scenario: the scene.
        judging: the formulas.
        make_world: factory of its world.
    """
    first: list[tuple[Reading, ...]] = []
    run_closed_loop(
        scenario, GroundTruth(), specs=judging.parsed_specs, stop_on=StopOn.VIOLATED,
        on_step=lambda step: first.append(step.readings) if not first else None,
        make_world=make_world,
    )
    return any(reading.interval.failed for reading in first[0])


def unsatisfiable(scenario: Scenario, judging: Judging, gains: Mapping[str, float]) -> str:
    """Why no run can satisfy one of the formulas, from the ranges of their signals; ''."""
    found = describe_specs(
        judging.parsed_specs, scenario.duration_s, SteeringGains(**gains), scenario
    ).warnings
    return next((text for text in found if UNSATISFIABLE in text), '')


def _with_domain(found: Evidence, scenes: Sequence[Mapping[str, Any]]) -> Evidence:
    """The evidence, with how the scenes are outside what the network was trained in."""
    outside = ''.join(domain_doubts(found.network, _domain_of(found.network), scenes))
    elsewhere = network_elsewhere(scenes) if outside else ''
    return replace(found, outside=outside, elsewhere=elsewhere)


def _domain_of(network: str) -> Domain | None:
    with contextlib.suppress(UsageError):  # its file is gone
        return find_domain(network)
    return None


def _of_runs(runs: CampaignRuns, *, subject: str) -> Evidence:
    found = runs.rate()
    rated = runs.weighting.rated
    several = runs.examined is not None and len(runs.examined.violated) > 1
    fail = f'violate {runs.spec}' if several else 'fail'
    controller = str(runs.facts.get('controller', '')) or 'unknown'
    return Evidence(
        subject=subject, network=runs.perception, controller=controller, spec=runs.spec,
        judged=len(runs.frame), failed=int(runs.failed.sum()),
        others={**runs.others},
        rate=f'{found.words()} of the scenes of {runs.scenes_words} {fail}' if rated else (
            'there is no failure rate of the program, as none of these runs was drawn by it alone'),
        searched='' if rated and runs.weight.all() else runs.sampler,
    )


def _outcomes(campaign: RecordedCampaign) -> dict[str, int]:
    """Runs without a verdict, infrastructure errors by kind."""
    others = Counter(str(row.outcome) for row in campaign.rows if not row.outcome.judged)
    broken = [row for row in campaign.rows if row.outcome is Outcome.INFRA_ERROR]
    kinds = Counter(row.kind or 'unknown' for row in broken)
    others.pop(str(Outcome.INFRA_ERROR), None)
    return {**{f'INFRA_ERROR ({kind})': number for kind, number in kinds.items()}, **others}


def _inside_words(cause: Mapping[str, Any]) -> str:
    inside, outside = cause['inside'], cause['outside']
    known = '' if inside['low'] is None else (
        f' ({100 * inside["low"]:.0f}–{100 * inside["high"]:.0f})')
    return (
        f'{100 * inside["rate"]:.0f} %{known} of {inside["runs"]:,} runs, elsewhere '
        f'{100 * outside["rate"]:.0f} %'
    )


def _paired(values: Mapping[str, Any] | None, words: str) -> Paired | None:
    if values is None:
        return None
    rates = values['satisfied']
    return Paired(
        words=words, scenes=values['pairs'], before=rates['base'], after=rates['arm'],
        difference=rates['difference'], low=rates['low'], high=rates['high'],
        p=rates['mcnemar_p'],
    )
