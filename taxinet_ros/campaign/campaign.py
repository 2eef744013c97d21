"""One campaign on disk: draws the scenes, keeps the ledger, writes the table.

A campaign's folder holds ``campaign.json`` (what was asked, and by which program text), one bag
folder per run, ``ledger.jsonl`` (append-only, the truth) and ``runs.csv``/``runs.parquet``
(derived from it).
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from taxinet_ros import __version__
from taxinet_ros.campaign.ledger import Ledger
from taxinet_ros.campaign.options import CampaignOptions, check_new
from taxinet_ros.campaign.programs import program_digest, program_text
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.scene_source import Rejected, SceneSource
from taxinet_ros.campaign.table import write_tables
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.world import last_step

PATIENCE = 2
"""After so many infrastructure errors in a row the bench is broken, not the run."""


class Campaign:
    """Asks for runs and takes their answers. A context manager that owns the Scenic child.

    Attributes:
        rows: one row per run taken, in order.
    """

    def __init__(
        self, options: CampaignOptions, participants: tuple[str, ...],
        on_row: Callable[[RunRow], None] = lambda row: None,
    ) -> None:
        """Nothing is started or written before the ``with``.

        Args:
            options: what to do.
            participants: node names that take part in every run.
            on_row: called with each row as soon as it is on disk.
        """
        self.options = options
        self.rows: list[RunRow] = []
        self._participants = participants
        self._on_row = on_row
        self._source = SceneSource(
            options.program, seed=options.seed, overrides=options.overrides
        )
        self._specs = tuple(parse_spec(text) for text in options.specs)
        self._next = 0
        self._broken = 0
        self._interrupted = False

    def __enter__(self) -> Self:
        """Compile the program, draw the first scene, and only then make the folder.

        Raises:
            UsageError: the program does not compile, or the folder cannot be made.
        """
        self._source.__enter__()
        try:
            self._first_scene()
            facts = self._facts()
            self._make_folder(facts)
            self._ledger = Ledger(self.options.out / 'ledger.jsonl')
            self._ledger.campaign(facts)
        except BaseException:
            self._source.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of what there is, whatever happened."""
        self._source.__exit__(None, None, None)
        self._ledger.__exit__(None, None, None)
        write_tables(self.rows, self.options.out, [spec.name for spec in self._specs])

    @property
    def unfinished(self) -> bool:
        """Whether there are runs left that it makes sense to try."""
        return (
            self._next < self.options.runs and self._broken < PATIENCE and not self._interrupted
        )

    def requests(self) -> Iterator[RunRequest]:
        """The runs still to do, drawn one at a time; scenes that cannot be drawn become rows."""
        while self._next < self.options.runs:
            index = self._next
            self._next += 1
            try:
                request = self._request(index, self._source.scene(index))
            except Rejected as error:
                self._keep(self._rejected(index, str(error)))
                continue
            self._ledger.intent(index, request.run_id)
            yield request

    def take(self, request: RunRequest, result: RunResult) -> bool:
        """Keep one answer; False where the graph should be given up."""
        bag = request.run_id if (self.options.out / request.run_id).is_dir() else ''
        sim_s = max(result.last_seq, 0) * CONTROL_PERIOD_NS / NS_PER_S
        perception = self.options.perception or result.perception
        self._keep(RunRow.of_run(request, result, perception=perception, sim_s=sim_s, bag=bag))
        infra = result.outcome is Outcome.INFRA_ERROR
        self._broken = self._broken + 1 if infra else 0
        self._interrupted = result.outcome is Outcome.INTERRUPTED
        return not infra and not self._interrupted

    def _keep(self, row: RunRow) -> None:
        self._ledger.result(row)
        self.rows.append(row)
        self._on_row(row)

    def _rejected(self, index: int, detail: str) -> RunRow:
        return RunRow(
            run_id=self._run_id(index), index=index, program=self._source.program.stem,
            seed=self.options.seed, perception=self.options.perception,
            outcome=Outcome.REJECTED, detail=detail,
        )

    def _run_id(self, index: int) -> str:
        return f'{self._source.program.stem}-s{self.options.seed}-{index:05d}'

    def _request(self, index: int, scenario: Scenario) -> RunRequest:
        return RunRequest(
            run_id=self._run_id(index),
            index=index,
            program=self._source.program.stem,
            seed=self.options.seed,
            scenario=scenario,
            specs=self.options.specs,
            participants=self._participants,
        )

    def _first_scene(self) -> None:
        with contextlib.suppress(Rejected):
            last_step(self._source.scene(0))

    def _make_folder(self, facts: dict[str, object]) -> None:
        out = self.options.out
        check_new(out)
        try:
            out.mkdir(parents=True, exist_ok=True)
            (out / 'campaign.json').write_text(json.dumps(facts, indent=2) + '\n')
        except OSError as error:
            raise UsageError(f'--out {out}: cannot be written: {error.strerror}') from error

    def _facts(self) -> dict[str, object]:
        path: Path = self._source.program
        options = self.options
        return {
            'taxinet_ros_version': __version__,
            'program': path.name,
            'program_sha256': program_digest(path),
            'program_text': program_text(path),
            'runs': options.runs,
            'seed': options.seed,
            'perception': options.perception,
            'overrides': dict(options.overrides),
            'gains': dict(options.gains),
            'specs': {spec.name: str(spec.formula) for spec in self._specs},
            'processes': options.processes,
        }


def exit_code(rows: list[RunRow]) -> int:
    """The exit code that a campaign's rows ask for.

    Returns:
        0 all satisfied, 1 some violated, 4 the bench broke, 130 interrupted.

    Raises:
        UsageError: every scene was rejected by the program's own requirements.
    """
    outcomes = {row.outcome for row in rows}
    if Outcome.INTERRUPTED in outcomes:
        return 130
    if Outcome.INFRA_ERROR in outcomes:
        return 4
    if Outcome.FAIL in outcomes:
        return 1
    if Outcome.PASS not in outcomes:
        raise UsageError('no run could be judged: every scene was rejected by its own requirements')
    return 0
