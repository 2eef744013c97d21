"""A campaign's folder in which runs ended in each of the five ways."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from campaign_records import write_campaign

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.core.verdict.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import program_text
from taxinet_ros.trials.options import CampaignOptions, make_options
from taxinet_ros.trials.record.book import finished_row, rejected_row, run_request
from taxinet_ros.trials.record.facts import campaign_facts
from taxinet_ros.trials.record.row import RunRow

COUNTS = {
    Outcome.PASS: 24, Outcome.FAIL: 12, Outcome.REJECTED: 2, Outcome.INFRA_ERROR: 3,
    Outcome.INTERRUPTED: 1,
}
JUDGED = COUNTS[Outcome.PASS] + COUNTS[Outcome.FAIL]
BROKEN = (
    RunResult(outcome=Outcome.INFRA_ERROR, kind='timeout', who='perception',
              detail='silent for 10 s', last_seq=12),
    RunResult(outcome=Outcome.INFRA_ERROR, kind='died', who='steering_controller',
              detail='killed by SIGKILL', last_seq=3),
    RunResult(outcome=Outcome.INFRA_ERROR, kind='timeout', who='simulator',
              detail='silent for 60 s', last_seq=0),
)


def five_outcomes(out: Path) -> tuple[CampaignOptions, list[RunRow]]:
    """Make the folder; what was asked, and the rows."""
    options = make_options(
        program='nominal', runs=sum(COUNTS.values()), seed=7, perception='truth', settings=(),
        specs=('phi_always',), out=out, processes=False, images='none',
    )
    rows = list(_rows(options))
    facts = campaign_facts(
        options, find_program(options.program), program_text(options.program)
    )
    write_campaign(out, rows, facts)
    return options, rows


def _rows(options: CampaignOptions):
    rng = np.random.default_rng(3)
    results = [*_judged(), *BROKEN, RunResult(outcome=Outcome.INTERRUPTED, last_seq=40)]
    for index, result in enumerate(results):
        scenario = scenario_from_human({
            'cross_track': float(rng.uniform(-8, 8)), 'heading': float(rng.uniform(-30, 30)),
            'distance': float(rng.uniform(0, 2000)), 'time_of_day': float(rng.uniform(6, 18)),
        })
        request = run_request(options, index, scenario, ('perception',))
        row = finished_row(options, request, dataclasses.replace(result, wall_s=1.0))
        yield row
    for index in range(len(results), len(results) + COUNTS[Outcome.REJECTED]):
        yield rejected_row(options, index, 'no scene meets the requirements')


def _judged():
    for outcome in (Outcome.PASS, Outcome.FAIL):
        for number in range(COUNTS[outcome]):
            rho = (1 if outcome is Outcome.PASS else -1) * (0.5 + number / 10)
            yield RunResult(
                outcome=outcome, robustness=exact_intervals({'phi_always': rho}), last_seq=300,
                statistics=RunStatistics(
                    max_cross_track_m=10.0 - rho, settle_time_s=1.0,
                    cte_error=ErrorStatistics(mean=0.0, mean_abs=0.0, max_abs=0.0),
                    he_error=ErrorStatistics(mean=0.0, mean_abs=0.0, max_abs=0.0),
                ),
            )
