"""``taxinet falsify``: search a program for violating scenes."""

from __future__ import annotations

import typer

from taxinet_ros.cli.options import (
    AuditOption,
    BoundOption,
    BudgetOption,
    ClusterOption,
    ControllerOption,
    EngineOption,
    ExitZeroOption,
    FallbackOption,
    ImagesOption,
    JsonSummaryOption,
    LagOption,
    LatencyOption,
    MonitorOption,
    MostRunsOption,
    ObjectiveOption,
    OddOption,
    OutOption,
    PerceptionOption,
    QuietOption,
    RateOption,
    ResumeOption,
    SamplerOption,
    SamplerSettingOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    SpecOption,
    StopOnOption,
    UntilOption,
    WorkersOption,
    WorldCameraOption,
    WorldOption,
    campaign_of,
    ended,
)


def falsify(
    context: typer.Context,
    program: ScenarioArgument,
    runs: MostRunsOption = 100,
    sampler: SamplerOption = None,
    sampler_option: SamplerSettingOption = None,
    odd: OddOption = None,
    objective: ObjectiveOption = None,
    workers: WorkersOption = 1,
    cluster: ClusterOption = None,
    lag: LagOption = 8,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    controller: ControllerOption = 'steering',
    monitor: MonitorOption = None,
    fallback: FallbackOption = None,
    world: WorldOption = 'kmwh',
    settings: SetOption = None,
    camera: WorldCameraOption = None,
    specs: SpecOption = None,
    until: UntilOption = None,
    budget: BudgetOption = None,
    images: ImagesOption = 'failures',
    stop_on: StopOnOption = 'never',
    bounds: BoundOption = None,
    rates: RateOption = None,
    latency: LatencyOption = None,
    engine: EngineOption = 'graph',
    audit: AuditOption = None,
    quiet: QuietOption = False,
    as_json: JsonSummaryOption = False,
    exit_zero: ExitZeroOption = False,
) -> None:
    """Search a Scenic program for violating scenes.

    The default sampler looks for failures unlike those already found, and draws every fourth run
    from the program itself to estimate failure rates; `--sampler ce` also learns where failures are
    likely. Can be resumed after Ctrl-C or power loss.
    """
    from taxinet_ros.cli.run.search import run_falsify
    from taxinet_ros.trials.record.facts import missing_packages_named
    from taxinet_ros.trials.search import make_search

    with missing_packages_named(out if resume else None):
        campaign = campaign_of(context)
        search = make_search(
            campaign, sampler=sampler, sampler_options=sampler_option or (), workers=workers,
            until=until, budget_min=budget, lag=lag, cluster=cluster, odd=odd,
            objective=objective,
        )
    raise ended(run_falsify(search, quiet=quiet, as_json=as_json), exit_zero)
