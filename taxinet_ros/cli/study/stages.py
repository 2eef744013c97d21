"""The functions of a study's stages: those of the commands, called in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import typer

from taxinet_ros.cli.commands import command_function
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode
from taxinet_ros.study.stages.stage import Stage
from taxinet_ros.trials.options import GRAPH, make_options
from taxinet_ros.trials.record.facts import missing_packages_named
from taxinet_ros.trials.search import make_search


def call_stage(stage: Stage, resume: bool) -> int:
    """Call the function of a stage; its paths are relative to the current folder.

    Returns:
        The exit code of its command.
    """
    options = stage.arguments(resume=resume)
    options['out'] = Path(options['out'])
    try:
        return _FUNCTIONS[stage.command](stage.argument, options)
    except typer.Exit as end:
        return end.exit_code


def _falsify(
    program: str, *, out: Path, runs: int, seed: int, sampler: str, sampler_option: Sequence[str],
    perception: str, images: str, workers: int = 1, engine: str = GRAPH, audit: str | None = None,
    cluster: str | None = None, resume: bool = False,
) -> int:
    from taxinet_ros.cli.run.search import run_falsify  # ROS takes time to import

    with missing_packages_named(out if resume else None):
        campaign = make_options(
            program=program, runs=runs, seed=seed, perception=perception, out=out, images=images,
            resume=resume, engine=engine, audit=audit,
        )
        search = make_search(
            campaign, sampler=sampler, sampler_options=sampler_option, workers=workers,
            cluster=cluster,
        )
    return run_falsify(search, quiet=False)


def _train(
    program: str, *, add: Sequence[str] = (), add_runs: Sequence[str] = (), **options: Any
) -> int:
    from taxinet_ros.cli.training.train import run_train  # torch takes time to import
    from taxinet_ros.training.data.portions import parse_portion
    from taxinet_ros.training.options import TrainOptions

    portions = (*(parse_portion(text, 'program') for text in add),
                *(parse_portion(text, 'runs') for text in add_runs))
    run_train(TrainOptions(program=program, add=portions, **options))
    return ExitCode.OK


def _report(_: str, options: Mapping[str, Any]) -> int:
    from taxinet_ros.study.report.report import report_case_study

    for line in report_case_study(options['out']):
        line_console().print(line)
    return ExitCode.OK


def _command(
    name: str, kind: Callable[[str], object] = Path
) -> Callable[[str, Mapping[str, Any]], int]:
    """The function of a command, whose argument is a path or of another kind."""
    return lambda argument, options: (
        command_function(name)(kind(argument), **options) or ExitCode.OK)


_FUNCTIONS: Mapping[str, Callable[[str, Mapping[str, Any]], int]] = {
    'falsify': lambda program, options: _falsify(program, **options),
    'train': lambda program, options: _train(program, **options),
    'experiment': _command('experiment', str),
    **{name: _command(name) for name in ('analyze', 'localize', 'explain', 'shrink')},
    'case-study': _report,
}
