"""``taxinet check``: a network in a few fixed scenes, in a minute, before a commit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import JsonOption, ProcessesCountOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode

if TYPE_CHECKING:
    from taxinet_ros.analysis.network_check import NetworkCheck

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
    from taxinet_ros.analysis.network_check import check_networks, fixed_scenes
    from taxinet_ros.cli.checked import tell_doubts
    from taxinet_ros.cli.progress import trial_bar
    from taxinet_ros.core.perception.perception import check_perception, network_doubts

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
            for line in _lines(one, allow)[:1 if quiet else None]:
                told.print(line)
    return next(code for code in _SEVERITY if code in codes)


def _lines(one: NetworkCheck, allowed: int) -> list[str]:
    from taxinet_ros.analysis.network_check import MOST_SHOWN, PROGRAM, SEED
    from taxinet_ros.trials.requirements import DEFAULT_JUDGING

    lines = [
        f'{one.network}: {one.count(True)} satisfied, {one.count(False)} violated, '
        f'{one.count(None)} unclear of {len(one.scenes)} scenes of {PROGRAM}, seed {SEED} '
        f'({DEFAULT_JUDGING.headline}; {allowed} violated allowed)'
    ]
    worst = one.worst()
    for scene, trial in worst[:MOST_SHOWN]:
        row = scene.row
        what = f'unclear: {trial.detail}' if trial.robustness is None else (
            f'rho {trial.robustness.lower:+.2f}' + ', off the runway' * bool(trial.left_runway))
        lines.append(
            f'  {row.run_id}: {what} ({row.time_of_day_h:.1f} h, {row.clouds}, rain '
            f'{row.rain_percent:.0f} %, {row.cross_track_m:+.1f} m, {row.heading_deg:+.0f}°, at '
            f'{row.distance_m:.0f} m)'
        )
    if len(worst) > MOST_SHOWN:
        lines.append(f'  and {len(worst) - MOST_SHOWN} more')
    if worst:
        lines.append(f'next: {one.command} --out bags/check; taxinet why bags/check')
    else:
        lines.append(
            f'next: taxinet falsify s_falsif --perception {one.network}, which searches for '
            'failures'
        )
    return lines
