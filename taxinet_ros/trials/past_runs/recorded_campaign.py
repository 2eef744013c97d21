"""Read-only access to a recorded campaign: facts, runs, rates, counterexamples, and single runs.

A run is named by its folder, ``<campaign>/<run>``. Its bag is read if it exists, since only the bag
has the exact scenario; else the campaign's record, so the bag may be deleted.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import holds_bag
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl import RobustnessInterval, parse_spec
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.system import System
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.examined import Examined, examine_runs
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.rates import ProgramRate, failure_rate, off_runway_rate
from taxinet_ros.trials.record.content import CampaignContent, read_campaign
from taxinet_ros.trials.record.facts import is_campaign, planned_runs, recorded_world
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import campaign_table

if TYPE_CHECKING:  # slow imports that reading rows does not need
    import pandas as pd

    from taxinet_ros.bag.run.facts import RunFacts
    from taxinet_ros.bag.run.recording import Recording


_Row = TypeVar('_Row')


@dataclass(frozen=True, kw_only=True)
class RecordedCampaign:
    """A recorded campaign, whether finished, interrupted or running.

    Attributes:
        folder: folder of the campaign.
        content: content of its record.
    """

    folder: Path
    content: CampaignContent

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts of the campaign: program, seed, perception, formulas."""
        return self.content.facts

    @property
    def rows(self) -> Sequence[RunRow]:
        """Latest result of each run, by index, in display units; many are read when asked for."""
        return self.content.rows

    @property
    def judged(self) -> tuple[RunRow, ...]:
        """The runs with a verdict."""
        return self._with(Outcome.PASS, Outcome.FAIL)

    @property
    def counterexamples(self) -> tuple[RunRow, ...]:
        """The runs that failed."""
        return self._with(Outcome.FAIL)

    def _with(self, *outcomes: Outcome) -> tuple[RunRow, ...]:
        found = enumerate(self.content.values('outcome'))
        return tuple(self.rows[at] for at, (outcome,) in found if outcome in outcomes)

    @property
    def judging(self) -> Judging:
        """Judging options; ``specs`` is empty if not recorded."""
        return Judging.from_facts(self.facts)

    def examine(self, spec: str | None = None) -> Examined:
        """The requirement to look into, of those that decided the outcomes.

        Args:
            spec: its name, if one was asked for.

        Raises:
            UsageError: the runs were not judged by it.
        """
        judged = [row.robustness for row in self.judged]
        names = tuple(self.facts.get('specs') or (judged[0] if judged else ('',)))
        return examine_runs(names, judged, asked=spec, where=str(self.folder))

    @property
    def gains(self) -> Mapping[str, float]:
        """Steering gains that differ from the defaults."""
        found: Mapping[str, float] = self.facts.get('gains', {})
        return found

    @property
    def timing(self) -> str:
        """Timing of answers as text (:mod:`taxinet_ros.core.pacing.timing`)."""
        told = next((row.timing for row in self.counterexamples or self.rows), '')
        return str(self.facts.get('timing') or told)

    @property
    def sampler(self) -> str:
        """Word of the sampler; '' if the program drew the scenes."""
        return next((row.sampler for row in self.counterexamples or self.rows), '')

    @property
    def planned_runs(self) -> range | None:
        """Indices of the runs planned before the first one, if known."""
        return planned_runs(self.facts)

    @property
    def failure_rate(self) -> ProgramRate:
        """Failure rate of the program with its interval (:mod:`taxinet_ros.trials.rates`)."""
        return failure_rate(self.rows, self.planned_runs)

    @property
    def off_runway_rate(self) -> ProgramRate | None:
        """Off-runway rate; None if a run was stopped too early to tell."""
        return off_runway_rate(self.rows, self.planned_runs)

    def table(self) -> pd.DataFrame:
        """Table with one row per run, by index, with the columns and types of ``runs.parquet``."""
        return campaign_table(self.content)

    def bag(self, row: RunRow) -> Path | None:
        """Folder of a run's bag; None if there is none."""
        found = self.folder / row.bag
        return found if row.bag and found.is_dir() else None

    def scenario(self, row: RunRow) -> tuple[Scenario, bool]:
        """The scenario of a run, and whether it is bit-exact.

        Raises:
            UsageError: it has no recorded scene, or its bag belongs to another run.
        """
        return scenario_of_row(row, self.folder, self.facts)


def open_campaign(folder: Path) -> RecordedCampaign:
    """Open the campaign in a folder read-only; it may be running.

    Raises:
        UsageError: it is not a campaign, or its record is damaged.
    """
    if not is_campaign(folder):
        old = ' (ledger.jsonl is of version 0.1.0, whose campaigns are not read any more)'
        also = old if (folder / 'ledger.jsonl').is_file() else ''
        raise UsageError(f'{folder}: not a campaign: no {RECORD_NAME} of one{also}')
    return RecordedCampaign(folder=folder, content=read_campaign(folder))


def open_failed_campaign(folder: Path) -> RecordedCampaign:
    """Open a campaign that has counterexamples.

    Raises:
        UsageError: as :func:`open_campaign`, or no run failed.
    """
    found = open_campaign(folder)
    if not found.counterexamples:
        raise UsageError(f'{folder}: none of its {len(found.judged)} judged runs failed')
    return found


def spread_evenly(rows: Sequence[_Row], most: int | None) -> tuple[_Row, ...]:
    """At most ``most`` of the rows, evenly spread; all if None."""
    if most is None or most >= len(rows):
        return tuple(rows)
    # The middle of each of ``most`` equal parts: no row twice, no bias to the first.
    return tuple(rows[(2 * k + 1) * len(rows) // (2 * most)] for k in range(most))


def scenario_of_row(
    row: RunRow, folder: Path, facts: Mapping[str, Any]
) -> tuple[Scenario, bool]:
    """The scenario of a run, and whether it is bit-exact.

    The bag is bit-exact; the record has nine decimals in human units. That is not enough to repeat
    a run: some pixels differ by one level, and the closed loop propagates it.

    Args:
        row: row of the run.
        folder: folder of its campaign.
        facts: facts of its campaign.

    Raises:
        UsageError: the record has no scene of it, or the bag belongs to another run.
    """
    bag = folder / row.run_id
    if holds_bag(bag):
        try:
            recording = _open_bag(bag)
            check_same_run(row, facts, recording)
            return recording.scenario, True
        except BagError:
            pass  # a damaged bag has less information than the record
    if None in row.scene.values():
        raise UsageError(f'{folder / row.run_id}: has neither a bag nor a recorded scene')
    return scenario_from_human(row.scene), False


_NO_FACTS: Mapping[str, Any] = {}


@dataclass(frozen=True, kw_only=True)
class JudgedRun(System):
    """One run, by a system as it reported itself; its timing has the run's own draws.

    Attributes:
        run_id, seed, scenario: as requested.
        specs: formulas as text, the headline first.
        outcome: how it ended.
        robustness: robustness by name of the formula.
        fingerprint: hash of the perception's weights.
    """

    run_id: str
    seed: int
    scenario: Scenario
    specs: tuple[str, ...]
    outcome: Outcome
    robustness: Mapping[str, RobustnessInterval]
    fingerprint: str

    @property
    def headline(self) -> str:
        """Name of the first formula."""
        return parse_spec(self.specs[0]).name

    def examine(self, spec: str | None = None) -> Examined:
        """The requirement to look into; arguments and errors as of a campaign."""
        names = Judging(specs=self.specs).names or ('',)
        return examine_runs(names, [self.robustness], asked=spec, where=self.run_id)


def find_run(path: Path) -> JudgedRun:
    """Find the run whose folder is, or was, ``path``.

    Raises:
        UsageError: there is none, its bag is damaged, or it has no scenario.
    """
    whole = _place(path)
    if is_campaign(whole):
        raise UsageError(f'{path}: a campaign{_example(path)}')
    content = read_campaign(whole.parent) if is_campaign(whole.parent) else None
    facts = content.facts if content else _NO_FACTS
    if holds_bag(whole):
        try:
            recording = _open_bag(path)
            for row in content.rows if content else ():
                if row.bag == whole.name:
                    check_same_run(row, facts, recording)
            return _of_bag(recording, facts)
        except BagError as error:
            raise UsageError(str(error)) from error
    rows = {row.run_id: row for row in content.rows} if content else {}
    if whole.name not in rows:
        raise UsageError(f'{path}: no such run; name it <campaign>/<run>, the path of its bag')
    return _of_row(rows[whole.name], facts)


def _open_bag(path: Path) -> Recording:
    from taxinet_ros.bag.run.recording import open_recording  # slow, and rows do not need it

    return open_recording(path)


def _place(path: Path) -> Path:
    """Folder of a run: the given campaign path takes precedence over a link's target."""
    named = Path(os.path.abspath(path))
    return named if is_campaign(named.parent) else path.resolve()


def _of_bag(recording: Recording, facts: Mapping[str, Any]) -> JudgedRun:
    path = recording.path
    ending = recording.metadata.get('taxinet_outcome')
    if ending is None and recording.runs and not recording.plain:
        raise UsageError(
            f'{path}: from another recorder; split it into one bag per run and name one of them: '
            f'taxinet bag split {path} --out DIR'
        )
    outcome = Outcome((ending or {}).get('outcome', Outcome.INTERRUPTED))
    run, told = recording.run, recording.facts
    robustness: dict[str, RobustnessInterval] = {}
    if outcome.judged and told is not None:
        robustness = {
            name: one.interval for name, one in told.judged.items()
        }
    return JudgedRun(
        run_id=run.request.run_id, seed=run.request.seed, scenario=run.request.scenario,
        specs=run.request.judging.specs, outcome=outcome, robustness=robustness,
        # A bag has the hash of a network's weights, not their file.
        perception=facts.get('perception') or run.perception,
        fingerprint=run.fingerprint, gains=run.gains or facts.get('gains', {}),
        controller=_controller(facts, run.controller),
        controller_sha256=run.controller_fingerprint,
        timing=run.timing.of_run(run.request.seed, run.request.index),
        world=run.world or KMWH, world_sha256=run.world_fingerprint,
    )


def _controller(facts: Mapping[str, Any], said: str) -> str:
    """Controller name recorded by the campaign, else the one that it reported."""
    word = str(facts.get('controller', STEERING))
    return said if said and word == STEERING else word


def _of_row(row: RunRow, facts: Mapping[str, Any]) -> JudgedRun:
    if None in row.scene.values():
        raise UsageError(f'{row.run_id}: {row.outcome}, no scene was drawn')
    formulas: Mapping[str, str] = facts.get('specs', {})
    world, package = recorded_world(facts)
    return JudgedRun(
        run_id=row.run_id, seed=row.seed, scenario=scenario_from_human(row.scene),
        specs=tuple(f'{name}={formula}' for name, formula in formulas.items()),
        outcome=row.outcome, robustness=row.robustness, perception=row.perception,
        fingerprint=row.fingerprint, gains=facts.get('gains', {}),
        controller=_controller(facts, ''),
        controller_sha256=str(facts.get('controller_sha256', '')),
        timing=parse_timing(row.timing).of_run(row.seed, row.index),
        world=world, world_sha256=package,
    )


def check_unchanged(
    role: str, word: str, find: Callable[[], str], recorded: str, fix: str
) -> None:
    """Check that the network or controller of recorded runs is here, and still that of the runs.

    Args:
        role: ``perception`` or ``controller``.
        word: its word or file; of a node that runs elsewhere nothing is known.
        find: gives its hash here.
        recorded: its hash in the runs.
        fix: what to do otherwise.

    Raises:
        UsageError: it is not.
    """
    before = f'sha256 {recorded[:12]}…' if recorded else 'without weights'
    try:
        found = find()
    except UsageError as error:
        raise UsageError(
            f"the run's {role} {word!r} ({before}) is not here: {error}; {fix}") from error
    if found != recorded and not is_node_elsewhere(word):
        now = f'sha256 {found[:12]}…' if found else 'without weights'
        raise UsageError(f'{role} {word} is {now} here, and was {before} in the runs; {fix}')


def _example(campaign: Path) -> str:
    """Hint for a path that names a campaign instead of a run."""
    rows = read_campaign(campaign).rows
    failed = [row for row in rows if row.outcome is Outcome.FAIL]
    if not failed:
        return ', and none of its runs failed'
    worst = min(failed, key=lambda row: min(row.rho.values(), default=0.0))
    return f'; name one of its {len(failed)} failed runs, as in {campaign / worst.run_id}'


def bag_differences(
    row: RunRow, facts: Mapping[str, Any], bag: Recording, *, whole: bool = True
) -> list[str]:
    """Differences between a bag and its run's row and campaign.

    What drove is not compared: another system gives another robustness, to the bit.

    Args:
        row: row of the run.
        facts: facts of its campaign.
        bag: its bag.
        whole: whether the bag is complete, so that the run's result is compared too.

    Raises:
        BagError, UsageError: it cannot be read.
    """
    told = bag.facts
    if told is None:
        return ['has no run of taxinet_ros']
    pairs: dict[str, tuple[Any, Any]] = {
        'run_id': (told.run_id, row.run_id), 'index': (told.index, row.index),
        'seed': (told.seed, row.seed), **_of_scene(told, row), **_of_formulas(told, facts),
    }
    if whole and row.outcome.judged:
        pairs |= {'outcome': (told.outcome, row.outcome.value), 'steps': (told.steps, row.steps)}
        pairs |= {
            f'rho of {name}': (one.interval, row.robustness.get(name))
            for name, one in told.judged.items()
        }
    return [
        f'its {name} is {here}, the row has {there}'
        for name, (here, there) in pairs.items() if here != there
    ]


def _of_scene(told: RunFacts, row: RunRow) -> dict[str, tuple[Any, Any]]:
    """Requested values in human units; empty for a row without a scene."""
    pairs = ((key, told.scene[key], there) for key, there in row.scene.items())
    return {
        key: (here, there) for key, here, there in pairs
        if there not in (None, '') and not _near(here, there)
    }


def _near(one: Any, other: Any) -> bool:
    """Whether two values are equal up to the ninth decimal, to which human units are rounded."""
    if isinstance(one, float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=2e-9)
    return bool(one == other)


def _of_formulas(told: RunFacts, facts: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Formulas by name: those that the monitor evaluated, or was requested to."""
    own = facts.get('specs')
    if not own:
        return {}
    here = {spec.name: spec.text for spec in map(parse_spec, told.specs)}
    # A name may have another formula in another version; the judged formula is recorded in full.
    here |= {name: told.judged[name].formula for name in here if name in told.judged}
    names = dict.fromkeys([*own, *here])
    nothing = 'not there'
    return {
        f'formula {name}': (here.get(name, nothing), own.get(name, nothing)) for name in names
    }


def check_same_run(
    row: RunRow, facts: Mapping[str, Any], bag: Recording, *, whole: bool = True
) -> None:
    """Check that a bag belongs to a row's run.

    Args:
        row: row of the run.
        facts: facts of its campaign.
        bag: its bag.
        whole: see :func:`bag_differences`.

    Raises:
        UsageError: it belongs to another run.
        BagError: it cannot be read.
    """
    for what in bag_differences(row, facts, bag, whole=whole):
        raise UsageError(
            f'{bag.path}: is not the bag of its run: {what}; was the folder moved here from '
            f'another campaign? Check all with taxinet doctor {bag.path.parent}'
        )


class BagPlaces:
    """Checks bags against the record of the campaign in whose folder they are, if any."""

    def __init__(self) -> None:
        """Create it without reading any record."""
        self._records: dict[Path, CampaignContent] = {}

    def check(self, bag: Path | Recording, *, whole: bool = True) -> None:
        """Check that a bag belongs to the run given by its path.

        Args:
            bag: a run's folder or an ``.mcap`` file, or a recording that has such a path.
            whole: see :func:`bag_differences`.

        Raises:
            UsageError: it belongs to another run.
            BagError: it cannot be read.
        """
        path = bag if isinstance(bag, Path) else bag.path
        folder = _place(path.parent if path.is_file() else path)
        campaign = folder.parent
        if not is_campaign(campaign):
            return
        if campaign not in self._records:
            try:
                self._records[campaign] = read_campaign(campaign)
            except UsageError:  # a bag can be read without its record
                self._records[campaign] = CampaignContent()
        record = self._records[campaign]
        recording = _open_bag(bag) if isinstance(bag, Path) else bag
        for row in record.rows:
            if row.bag == folder.name:
                check_same_run(row, record.facts, recording, whole=whole)
                return
        told = recording.facts
        if told is not None and told.run_id != folder.name and '.broken-' not in folder.name:
            raise UsageError(
                f'{path}: is not the bag of its run: its run_id is {told.run_id}; '
                f'taxinet doctor {folder.parent} checks all of them'
            )
