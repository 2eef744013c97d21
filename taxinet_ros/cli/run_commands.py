"""The commands that run scenarios: ``taxinet run``, ``falsify`` and ``demo``."""

from __future__ import annotations

import typer

from taxinet_ros.cli.option_types import (
    BudgetOption,
    ImagesOption,
    MostRunsOption,
    OutOption,
    PerceptionOption,
    ProcessesOption,
    QuietOption,
    ResumeOption,
    RunsOption,
    SamplerOption,
    SamplerSettingOption,
    ScenarioArgument,
    SeedOption,
    SetOption,
    SpecOption,
    UntilOption,
    WorkersOption,
)


def run(
    scenario: ScenarioArgument,
    runs: RunsOption = 1,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    settings: SetOption = None,
    spec: SpecOption = None,
    out: OutOption = None,
    processes: ProcessesOption = False,
    images: ImagesOption = 'all',
) -> None:
    """Run a Scenic program's scenes through the graph.

    Every run ends in a bag of its own, and in a row of the campaign's table.
    """
    from taxinet_ros.campaign.options import make_options
    from taxinet_ros.cli.campaign import run_campaign

    options = make_options(
        program=scenario, runs=runs, seed=seed, perception=perception,
        settings=settings or (), specs=spec or (), out=out, processes=processes,
        images=images,
    )
    raise typer.Exit(run_campaign(options))


def falsify(
    scenario: ScenarioArgument,
    runs: MostRunsOption = 100,
    sampler: SamplerOption = 'ce',
    sampler_option: SamplerSettingOption = None,
    workers: WorkersOption = 1,
    out: OutOption = None,
    resume: ResumeOption = False,
    seed: SeedOption = 0,
    perception: PerceptionOption = 'taxinet',
    settings: SetOption = None,
    spec: SpecOption = None,
    until: UntilOption = None,
    budget: BudgetOption = None,
    images: ImagesOption = 'none',
    quiet: QuietOption = False,
) -> None:
    """Search a Scenic program for violating scenes.

    The worse a run, the more like it the sampler may choose. Survives Ctrl-C and power cuts.
    """
    from taxinet_ros.campaign.options import make_options
    from taxinet_ros.campaign.search_options import make_search_options
    from taxinet_ros.cli.falsify import run_falsify

    campaign = make_options(
        program=scenario, runs=runs, seed=seed, perception=perception, settings=settings or (),
        specs=spec or (), out=out, processes=False, images=images, resume=resume,
    )
    options = make_search_options(
        campaign, sampler=sampler, sampler_options=sampler_option or (), workers=workers,
        resume=resume, until=until, budget_min=budget,
    )
    raise typer.Exit(run_falsify(options, quiet=quiet))


def demo(
    out: OutOption = None,
    runs: RunsOption = 10,
    seed: SeedOption = 1,
) -> None:
    """Run ten scenes with both networks and with the truth.

    Draws their paths and their camera frames.
    """
    from taxinet_ros.cli.demo import run_demo

    raise typer.Exit(run_demo(out, runs=runs, seed=seed))
