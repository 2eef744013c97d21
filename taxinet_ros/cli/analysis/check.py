"""``taxinet check``: a network in a few fixed scenes, in a minute, before a commit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import JsonOption, ProcessesCountOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode

_SEVERITY = (ExitCode.VIOLATED, ExitCode.INCOMPLETE, ExitCode.OK)


def check(
    networks: Annotated[
        list[str],
        typer.Argument(
            metavar='NETWORK...', help='words or files: .safetensors, .onnx, or FILE.py:NAME'
        ),
    ],
    runs: Annotated[
        int, typer.Option(min=1, help='so many of the fixed scenes, from the first')
    ] = 50,
    allow: Annotated[
        int, typer.Option(min=0, metavar='SCENES', help='accepted number of violated scenes')
    ] = 0,
    workers: ProcessesCountOption = 2,
    quiet: Annotated[
        bool, typer.Option('--quiet', help='print a line for a network that is not good, else '
        'nothing')
    ] = False,
    as_json: JsonOption = False,
) -> int:
    """Drive networks through 50 fixed scenes, as a quick check before a commit.

    The scenes are the same for everybody: drawn from s_falsif with a fixed seed, driven in the
    closed loop without ROS. Exit code 0 if no more scenes violate phi_eventually than allowed, 1 if
    more do, 3 if runs without a verdict leave it open. A smoke test; for a statement about all
    scenes use gate.
    """
    from taxinet_ros.analysis.network_check import (
        MOST_SHOWN,
        PROGRAM,
        SEED,
        check_networks,
        fixed_scenes,
    )
    from taxinet_ros.analysis.report.text import macro_text
    from taxinet_ros.cli.checked import tell_doubts
    from taxinet_ros.cli.progress import trial_bar
    from taxinet_ros.core.perception.perception import check_perception, network_doubts
    from taxinet_ros.trials.requirements import DEFAULT_JUDGING

    told = line_console(stderr=as_json)
    for network in networks:
        check_perception(network)
    scenes = fixed_scenes(runs)
    drawn = [scene.scenario for scene in scenes]
    named = () if quiet else networks
    tell_doubts(line for network in named for line in network_doubts(network, drawn))
    bars = line_console(stderr=True, quiet=quiet)
    with trial_bar(bars, 'scenes', len(networks) * len(scenes)) as (count, interrupted):
        found = list(check_networks(
            networks, scenes, workers=workers, on_trial=(lambda: None) if quiet else count,
            interrupted=interrupted,
        ))
    if len(found) < len(networks):
        told.print('interrupted; nothing is kept')
        return ExitCode.INTERRUPTED
    if as_json:
        print_json([one.json(allow) for one in found])
    codes = [one.code(allow) for one in found]
    for one, code in zip(found, codes, strict=True):
        if not quiet or code is not ExitCode.OK:
            text = macro_text(
                Path(__file__).with_suffix('.j2'), 'checked', one=one, allowed=allow,
                most=MOST_SHOWN, program=PROGRAM, seed=SEED, headline=DEFAULT_JUDGING.headline,
            )
            told.print(text.partition('\n')[0] if quiet else text)
    return next(code for code in _SEVERITY if code in codes)
