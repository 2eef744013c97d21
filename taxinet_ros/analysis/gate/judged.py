"""The runs that a gate judges: a campaign's, or those of a network in the scenes of a baseline."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.analysis.gate.baseline import against_baseline
from taxinet_ros.analysis.gate.criteria import GateOptions, GateResult, gate_result
from taxinet_ros.analysis.gate.report import junit_xml, rerun_documents
from taxinet_ros.bag.check.findings import ranges
from taxinet_ros.core.pacing.timing import is_free
from taxinet_ros.core.perception.perception import check_perception, network_doubts
from taxinet_ros.core.provenance import differences
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically, write_parquet
from taxinet_ros.files.outputs import check_output
from taxinet_ros.trials.options import DEFAULT_ROOT
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.past_runs.shared_scenes import SharedTrials, scenes_of
from taxinet_ros.trials.rates import Planned
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import (
    STACKS,
    is_campaign,
    recorded_rules,
    recorded_stacks,
)
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import PARQUET_NAME, table
from taxinet_ros.version import __version__

Progress = Callable[[int], AbstractContextManager[tuple[Callable[[], None], Callable[[], bool]]]]


@dataclass(frozen=True, kw_only=True)
class JudgedRuns:
    """Runs to be judged.

    Attributes:
        folder: their folder.
        rows: the runs.
        facts: facts of their campaign.
        planned: the runs that were planned.
        notes: remarks on them.
        again: they were made in the scenes of the baseline, with its settings.
    """

    folder: Path
    rows: Sequence[RunRow]
    facts: Mapping[str, Any]
    planned: Planned
    notes: tuple[str, ...]
    again: bool = False

    @property
    def name(self) -> str:
        """What commands call these runs: folder, or table."""
        return str(self.folder / PARQUET_NAME if self.again else self.folder)

    def table(self) -> pd.DataFrame:
        """The runs' table, with its provenance."""
        frame = table(self.rows, tuple(self.facts.get('specs', {})))
        frame.attrs[STACKS] = recorded_stacks(self.facts)
        return frame

    def answer(self, options: GateOptions, baseline: Path | None) -> GateResult:
        """The gate's answer.

        Raises:
            UsageError: the runs cannot be judged, or not be paired with those of the baseline.
        """
        paired = criterion = None
        if baseline is not None and options.margin is not None:
            paired = against_baseline(self.table(), self.folder, baseline, again=self.again)
            command = shlex.join(['taxinet', 'compare', str(baseline), self.name])
            criterion = paired.criterion(options.margin, options.confidence, command)
        found = gate_result(
            self.rows, options, planned=self.planned or 0, compared=criterion,
            rules=recorded_rules(self.facts),
            folder='' if self.again else self.name,  # these commands do not take a table
        )
        notes = (*found.notes, *self.notes, *(paired.notes if paired else ()))
        return replace(found, notes=notes, baseline=paired)

    def write_junit(
        self, junit: Path | None, answer: GateResult, *, inconclusive_passes: bool
    ) -> Path | None:
        """Write the JUnit file, and beside it the documents of its commands and the runs' table.

        The folder of a campaign is only read, since the campaign may be running.

        Returns:
            The table that ``taxinet analyze`` takes: the runs' own, or the one beside the file.
        """
        own = self.folder / PARQUET_NAME
        table = own if own.is_file() else None
        if junit is None:
            return table
        if not self.again:
            table = table_beside(junit)
            write_parquet(table, self.table())
        document = junit_xml(
            self.rows, answer, self.folder, self.facts, table=table,
            inconclusive_passes=inconclusive_passes, documents=junit.parent,
        )
        texts = rerun_documents(self.rows, self.facts)
        for name in texts:
            path = junit.parent / name
            check_output(f'junit {junit}: {path}', path, own=[path.suffix])
        for name, text in texts.items():
            write_atomically(junit.parent / name, text)
        write_atomically(junit, document)
        return table


def table_beside(junit: Path) -> Path:
    """The table beside a JUnit file."""
    return junit.with_name(f'{junit.stem}-{PARQUET_NAME}')


def check_junit(junit: Path, inputs: Sequence[Path]) -> None:
    """Check that the table beside the JUnit file can be written, and that its folder exists.

    Raises:
        UsageError: it cannot.
    """
    if not junit.parent.is_dir():
        raise UsageError(f'junit {junit}: no such folder: {junit.parent}')
    beside = table_beside(junit)
    check_output(f'junit {junit}: {beside}', beside, inputs=inputs, own=['.parquet'])


def recorded_runs(campaign: Path) -> JudgedRuns:
    """The runs of a campaign.

    Raises:
        UsageError: it cannot be read.
    """
    recorded = open_campaign(campaign)
    return JudgedRuns(
        folder=campaign, rows=recorded.rows, facts=recorded.facts,
        planned=recorded.planned_runs, notes=tuple(_record_notes(recorded.content)),
    )


def driven_runs(
    network: str, baseline: Path, out: Path | None, workers: int, progress: Progress,
    tell: Callable[[Iterable[str]], None], *, shares: bool,
) -> JudgedRuns:
    """The network's runs in the baseline's scenes, finished ones kept in the folder.

    Args:
        network: word or file.
        baseline: folder or table.
        out: folder of the runs, or None for one below ``bags/``.
        workers: number of processes.
        progress: context, by the number of runs, with a function to call after each and one that
            says whether to start no more.
        tell: called with doubts about the network in these scenes.
        shares: whether the share of satisfied runs counts, so that each requirement is needed.

    Raises:
        UsageError: there is no such network, or the scenes cannot be driven.
        KeyboardInterrupt: runs are left.
    """
    fingerprint, scenes = check_perception(network), scenes_of(baseline, whole=shares)
    system = scenes.system
    out = out or DEFAULT_ROOT / f'gate-{Path(network).stem.replace(":", "-")}'
    tell(network_doubts(network, (scene.scenario for scene in scenes.scenes)))
    with SharedTrials(scenes, out) as trials, progress(len(scenes.scenes)) as (count, interrupted):
        trials.drive(network, workers=workers, on_trial=count, interrupted=interrupted)
        rows = tuple(trials.rows(network))
    rough = sum(not scene.exact for scene in scenes.scenes)
    notes = (
        f'{rough:,} of {len(scenes.scenes):,} scenes are from the table alone, rounded to nine '
        'decimals, as the baseline has no bags: enough but for a run at the very edge',
    ) if rough else ()
    judged = JudgedRuns(
        folder=out, rows=rows, notes=notes, again=True,
        planned=None if scenes.fixed else _planned(baseline, rows), facts={
            'taxinet_ros_version': __version__, 'baseline': str(baseline),
            'program': rows[0].program, 'seed': rows[0].seed, 'perception': network,
            'perception_sha256': fingerprint, 'controller': system.controller,
            'gains': dict(system.gains), 'timing': system.timing.words, 'world': system.world,
            **scenes.judging.facts(),
        },
    )
    write_parquet(out / PARQUET_NAME, judged.table())
    return judged


def _planned(baseline: Path, rows: Sequence[RunRow]) -> range:
    """The runs that the baseline planned, which are other ones than its runs."""
    if is_campaign(baseline) and (found := open_campaign(baseline).planned_runs):
        return found
    return range(max(row.index for row in rows) + 2)  # more than there are: the number was open


def _record_notes(content: CampaignContent) -> Iterator[str]:
    """Notes about the campaign's record."""
    if found := differences(*recorded_stacks(content.facts).values()):
        yield f'the runs were made on different machines or versions: {found}'
    if content.finished and content.unfinished:
        yield f'run {ranges(content.unfinished)}: started but has no result'
    for timing in sorted({row.timing for row in content.rows if row.timing}):
        again = ', so their verdicts are not reproducible' if is_free(timing) else ''
        yield f'timing of the runs: {timing}{again}'
