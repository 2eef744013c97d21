"""Campaigns from Python: runs, counterexamples, rates, comparisons, and coverage of an ODD."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.arguments import FINITE, NONE, PATH, WORD, Kind, takes
from taxinet_ros.bag.layout import STORAGE_ID, holds_bag
from taxinet_ros.bag.run import recording
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.core.mtl.interval import RobustnessInterval
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.files.pages import html_table
from taxinet_ros.trials.past_runs import recorded_campaign
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.trials.rates import ProgramRate
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.stress import LikeliestFailure, likeliest_failure

if TYPE_CHECKING:
    import pandas as pd

    from taxinet_ros.analysis.campaign.compared import Compared
    from taxinet_ros.analysis.odd.coverage import OddCoverage
    from taxinet_ros.api.plots import Plot

_PATHS = PATH | Kind('a list of paths', lambda value: isinstance(value, list | tuple) and bool(
    value) and all(PATH.has(one) for one in value))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Counterexample:
    """A failed run of a campaign.

    Attributes:
        row: its row in the campaign's record.
        campaign: the campaign.
    """

    row: RunRow
    campaign: RecordedCampaign

    @property
    def run_id(self) -> str:
        """Name of the run and of its folder."""
        return self.row.run_id

    @property
    def rho(self) -> Mapping[str, RobustnessInterval]:
        """Robustness interval by requirement; the ends are equal if it is known exactly."""
        return self.row.robustness

    @property
    def headline(self) -> RobustnessInterval:
        """Robustness of the first requirement."""
        return next(iter(self.rho.values()))

    @cached_property
    def scenario(self) -> Scenario:
        """Scenario of the run: exact if there is a bag, else to nine decimals.

        Raises:
            UsageError: the bag beside the campaign belongs to another run.
        """
        return self.campaign.scenario(self.row)[0]

    @property
    def bag(self) -> Path | None:
        """Folder of its bag; None if there is none."""
        return self.campaign.bag(self.row)

    def __repr__(self) -> str:
        return f'<Counterexample {self.run_id}: {next(iter(self.rho))} {self.headline.words()}>'


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Campaign:
    """Runs of ``taxinet run``, ``falsify``, ``shrink`` or an experiment arm; read-only.

    Attributes:
        recorded: contents of the campaign's record.
    """

    recorded: RecordedCampaign

    @property
    def folder(self) -> Path:
        """Folder of the campaign."""
        return self.recorded.folder

    @property
    def facts(self) -> Mapping[str, Any]:
        """Settings: program, seed, sampler, perception, requirements, version, machines."""
        return self.recorded.facts

    @cached_property
    def rows(self) -> pd.DataFrame:
        """A row per run, by index; the columns of ``runs.parquet`` (``docs/analysis.md``).

        ``outcome``, ``rho`` of the headline, ``rho_<name>`` of each requirement (in its unit), the
        scenario in the units given by the column names (``heading_deg``, ``rain_percent``,
        ``time_of_day_h``), and the statistics of the run.
        """
        return self.recorded.table()

    @cached_property
    def counterexamples(self) -> tuple[Counterexample, ...]:
        """Failed runs, by index."""
        return tuple(
            Counterexample(row=row, campaign=self.recorded) for row in self.recorded.counterexamples
        )

    @cached_property
    def likeliest_failure(self) -> LikeliestFailure | None:
        """The likeliest failure found with the sampler ``stress``; None if there is none.

        ``.sigma`` is its distance from the means [standard deviations], ``.log_likelihood`` the
        natural logarithm of its likelihood less that of the means, ``.deviations`` that of each
        choice [standard deviations], ``.row`` its run.
        """
        return likeliest_failure(self.recorded.sampler, self.recorded.counterexamples)

    @property
    def rates(self) -> Mapping[str, ProgramRate]:
        """Failure rates of the program's own runs: ``failed``, and ``off_runway`` if known.

        ``.value``, ``.low`` and ``.high`` are the fraction and its 95 % interval, None if no run
        counts (``.why_not`` says why). It is based on runs drawn by the program, not on those
        chosen by a sampler.
        """
        off = self.recorded.off_runway_rate
        return {'failed': self.recorded.failure_rate} | ({'off_runway': off} if off else {})

    def plot(self) -> Plot:
        """How often runs fail, by feature of the scene; notebooks show it.

        Raises:
            UsageError: no run was judged.
        """
        from taxinet_ros.analysis.campaign.figures import rates_picture
        from taxinet_ros.analysis.runs.campaign import read_examined
        from taxinet_ros.api.plots import Plot

        return Plot(picture=rates_picture([read_examined(self.folder)]))

    @takes(out=NONE | PATH)
    def report(self, out: str | os.PathLike[str] | None = None) -> Path:
        """Find the causes of the failures and write a report, as ``taxinet analyze`` does.

        Args:
            out: folder of the report; None: ``analysis`` in the campaign's folder.

        Returns:
            The page.

        Raises:
            UsageError: no run was judged, or the folder contains something else.
        """
        from taxinet_ros.analysis.campaign.findings import analyse
        from taxinet_ros.analysis.campaign.folder import PAGE_NAME, check_folder, write_analysis
        from taxinet_ros.analysis.campaign.report import campaign_report
        from taxinet_ros.analysis.runs.campaign import read_examined

        folder = self.folder / 'analysis' if out is None else Path(out)
        check_folder(folder)
        findings = analyse(read_examined(self.folder))
        write_analysis(findings, campaign_report(findings), folder)
        return folder / PAGE_NAME

    def __repr__(self) -> str:
        runs, failed = len(self.recorded.rows), len(self.recorded.counterexamples)
        return f'<Campaign {self.folder}: {runs} runs, {failed} failed>'

    def _repr_html_(self) -> str:
        facts = {name: self.facts[name] for name in ('program', 'perception', 'sampler')
                 if self.facts.get(name)}
        return html_table(repr(self)[1:-1], {**facts, **self.rates})


@takes(path=PATH)
def open_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Read a campaign's folder; an unfinished campaign gives the runs so far.

    Args:
        path: the folder.

    Raises:
        UsageError: not a campaign, or its record is damaged.
    """
    folder = Path(path)
    if not is_campaign(folder):
        if folder.suffix == f'.{STORAGE_ID}' or holds_bag(folder):
            raise UsageError(f'{folder}: a bag, no campaign; open it with tx.open_recording')
        if not folder.exists():
            raise UsageError(f'{folder}: no such folder; give that of a campaign')
    return Campaign(recorded=recorded_campaign.open_campaign(folder))


@takes(path=PATH)
def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Open a bag of one or several runs and read its messages in one pass.

    Damage does not raise: the intact part is read, see :attr:`Recording.damage`.

    Args:
        path: a bag's folder or an ``.mcap`` file.

    Raises:
        UsageError: ``path`` does not exist, is a campaign, or has an unsupported format.
        BagError: it is empty, not a ROS 2 bag, or unreadable.
    """
    folder = Path(path)
    if is_campaign(folder):
        raise UsageError(
            f'{folder}: a campaign, no bag; open it with tx.open_campaign, or one of the folders '
            'in it'
        )
    return recording.open_recording(folder)


@takes(before=PATH, after=PATH)
def compare(before: str | os.PathLike[str], after: str | os.PathLike[str]) -> Compared:
    """Compare two campaigns, scene by scene, as ``taxinet compare`` does.

    Args:
        before: folder of a campaign, or a table of one.
        after: the same of the second network.

    Returns:
        ``.satisfied`` (counts of the pairs, their ``difference`` with its 95 % interval and the
        ``p_value`` of McNemar's exact test, valid if ``.tested``), ``.scenes`` (a row per scene),
        and the causes of what got ``.better`` and ``.worse``.

    Raises:
        UsageError: they have no scene in common, or are judged by different requirements.
    """
    from taxinet_ros.analysis.campaign.compared import compared
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs

    first = read_runs(Path(before))
    return compared(*distinct_labels([first, read_runs(Path(after), first.spec)]))


@takes(campaigns=_PATHS, odd=PATH, spec=NONE | WORD, below=NONE | FINITE)
def odd_coverage(
    campaigns: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    odd: str | os.PathLike[str], *, spec: str | None = None, below: float | None = None,
) -> OddCoverage:
    """Measure what campaigns cover of an operational design domain, as ``taxinet odd`` does.

    Args:
        campaigns: folder or table of a campaign, or several, of one system.
        odd: name of a shipped ODD, or its YAML file.
        spec: formula that defines failure; None for the headline.
        below: also count the combinations of cells that fail less often than this share, at 95 %.

    Returns:
        ``.inside``, ``.outside``, the runs and rate of each of the ``.cells``, ``.strengths``
        (combinations of 1, 2 and 3 cells: ``feasible``, ``covered``), ``.gaps``.

    Raises:
        UsageError: a mistake in the ODD, campaigns that cannot be counted together, or a limit
            that is no share.
    """
    from taxinet_ros.analysis.odd import coverage
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
    from taxinet_ros.trials.odd.odd_file import find_odd, read_odd

    if below is not None and not 0 < below < 1:
        raise UsageError(f'below={below:g}: needs to be a share above 0 and below 1')
    several = [campaigns] if isinstance(campaigns, str | os.PathLike) else campaigns
    first = read_runs(Path(several[0]), spec)
    runs = [first, *(read_runs(Path(one), first.spec) for one in several[1:])]
    return coverage.odd_coverage(
        read_odd(find_odd(os.fspath(odd))), distinct_labels(runs), limit=below
    )
