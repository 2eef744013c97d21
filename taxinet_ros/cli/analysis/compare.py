"""``taxinet compare``: two networks on the same scenes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import (
    BoundOption,
    ControllerOption,
    JsonOption,
    LatencyOption,
    ProcessesCountOption,
    RateOption,
    SetOption,
    WorldCameraOption,
    WorldOption,
    given_among,
)
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode, UsageError

_OF_PROGRAM = (
    'seed', 'spec', 'settings', 'controller', 'world', 'camera', 'latency', 'bound', 'rate',
)
"""Options that only the scenes of a program have."""


def compare(
    context: typer.Context,
    before: Annotated[
        str, typer.Argument(metavar='A', help='campaign or table, or a network: word or file')
    ],
    after: Annotated[str, typer.Argument(metavar='B', help='the same, to be compared with A')],
    scenes: Annotated[
        str | None,
        typer.Argument(
            metavar='[SCENES]',
            help='of two networks: a program, or a campaign, table or run whose scenes both drive',
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help='number of scenes (default: 100 of a program, else '
        'all of them); fewer are spread evenly')
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help='seed of the scenes of a program (default 0)')
    ] = None,
    spec: Annotated[
        list[str] | None,
        typer.Option('--spec', metavar='FORMULA', help='requirement for the scenes of a program '
        '(default phi_eventually)'),
    ] = None,
    settings: SetOption = None,
    controller: ControllerOption = 'steering',
    world: WorldOption = 'kmwh',
    camera: WorldCameraOption = None,
    latency: LatencyOption = None,
    bound: BoundOption = None,
    rate: RateOption = None,
    workers: ProcessesCountOption = 2,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for page and tables; finished runs in it are kept'),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Compare two networks on the same scenes: what got better, what got worse, and why.

    Takes two campaigns or tables of the same scenes, or two networks and the scenes, which both
    then drive in the closed loop without ROS; those of a program with the settings that run takes.
    Gives the paired difference with its interval and McNemar's exact test, the scenes that changed,
    and what they have in common. After an interrupt, the same command continues.
    """
    from taxinet_ros.analysis.campaign.compared import (
        PAGE_NAME,
        compare_folder,
        compared,
        compared_report,
        driven_campaigns,
        write_compared,
    )
    from taxinet_ros.analysis.runs.campaign import distinct_labels, read_runs
    from taxinet_ros.cli.progress import trial_bar
    from taxinet_ros.core.perception.perception import check_perception, perception_names
    from taxinet_ros.core.world import world_word
    from taxinet_ros.scenes.programs import known_programs
    from taxinet_ros.trials.options import LOOP, make_options, make_out
    from taxinet_ros.trials.past_runs.shared_scenes import scenes_of, scenes_of_options
    from taxinet_ros.trials.record.facts import is_campaign

    console = line_console(stderr=as_json)
    networks = before, after
    # With scenes they are networks: a known word is one, also beside a folder of that name.
    known = () if scenes is None else perception_names()
    named = [
        word not in known and (is_campaign(Path(word)) or word.endswith('.parquet'))
        for word in networks
    ]
    of_program = given_among(context, _OF_PROGRAM)
    if all(named) and scenes is None:
        if given := ['--runs'] * (runs is not None) + of_program:
            raise UsageError(f'{given[0]}: the scenes are those of the campaigns; leave it out')
        out = compare_folder(out, networks)
        first = read_runs(Path(before))
        found = compared(*distinct_labels((first, read_runs(Path(after), first.spec))))
        make_out(out)
    else:
        if any(named):
            raise UsageError(
                'compare: name two campaigns, or two networks and the scenes: a program, a '
                'campaign, a table or a run'
            )
        if scenes is None:
            raise UsageError(
                f'compare {before} {after}: two networks need scenes: a program, '
                'a campaign, a table or a run'
            )
        for network in networks:
            check_perception(network)
        out = compare_folder(out, networks)
        if scenes in known_programs() or not (
            Path(scenes).is_dir() or scenes.endswith('.parquet')
        ):
            shared = scenes_of_options(make_options(
                program=scenes, runs=100 if runs is None else runs, seed=seed or 0,
                perception=before, settings=settings or (), specs=spec or (), bounds=bound or (),
                rates=rate or (), controller=controller, latency=latency or (),
                world=world_word(world, camera), out=out, processes=False, resume=True,
                engine=LOOP,
            ))
        elif of_program:
            raise UsageError(f'{of_program[0]}: the scenes are those of {scenes}; leave it out')
        else:
            shared = scenes_of(Path(scenes), runs)
        make_out(out)
        total = len(networks) * len(shared.scenes)
        with trial_bar(console, 'runs', total) as (count, interrupted):
            driven = driven_campaigns(shared, networks, out, workers, count, interrupted)
        # Nothing but the network differs between these runs.
        found = replace(compared(*distinct_labels(driven)), differing=())
    values = write_compared(found, out)
    if as_json:
        print_json(values)
    for sentence in compared_report(found).summary:
        console.print(sentence)
    console.print(f'page: {out / PAGE_NAME}')
    return ExitCode.OK
