"""``taxinet check``: a network in a few fixed scenes, in a minute, before a commit."""

from __future__ import annotations

import json
from collections.abc import Sequence

from rich.console import Console

from taxinet_ros.analysis.network_check import (
    MOST_SHOWN,
    PROGRAM,
    SEED,
    NetworkCheck,
    check_networks,
    fixed_scenes,
)
from taxinet_ros.cli.checked import tell_doubts
from taxinet_ros.cli.progress import trial_bar
from taxinet_ros.core.perception.perception import check_perception, network_doubts
from taxinet_ros.errors import ExitCode
from taxinet_ros.trials.requirements import DEFAULT_JUDGING

_SEVERITY = (ExitCode.VIOLATED, ExitCode.INCOMPLETE, ExitCode.OK)


def run_check(
    networks: Sequence[str], *, runs: int, allowed: int, workers: int, quiet: bool, as_json: bool
) -> int:
    """Check the networks and print what came out.

    Args:
        networks: words or files.
        runs: number of the fixed scenes.
        allowed: number of violated scenes that is accepted.
        workers: processes.
        quiet: print a line for each network that is not as it should be, and nothing else.
        as_json: print JSON.

    Returns:
        Exit code: 0 no more scenes violated than allowed, 1 more, 3 not known, 130 interrupted;
        of several networks the worst.

    Raises:
        UsageError: there is no such network.
    """
    told = Console(highlight=False, stderr=as_json)
    for network in networks:
        check_perception(network)
    scenes = fixed_scenes(runs)
    drawn = [scene.scenario for scene in scenes]
    named = () if quiet else networks
    tell_doubts(line for network in named for line in network_doubts(network, drawn))
    bars = Console(highlight=False, stderr=True, quiet=quiet)
    with trial_bar(bars, 'scenes', len(networks) * len(scenes)) as (count, interrupted):
        found = list(check_networks(
            networks, scenes, workers=workers, on_trial=(lambda: None) if quiet else count,
            interrupted=interrupted,
        ))
    if len(found) < len(networks):
        told.print('interrupted; nothing is kept', soft_wrap=True)
        return ExitCode.INTERRUPTED
    if as_json:
        print(json.dumps([one.json(allowed) for one in found], indent=2, allow_nan=False))
    codes = [one.code(allowed) for one in found]
    for one, code in zip(found, codes, strict=True):
        if not quiet or code is not ExitCode.OK:
            for line in _lines(one, allowed)[:1 if quiet else None]:
                told.print(line, soft_wrap=True, markup=False)
    return next(code for code in _SEVERITY if code in codes)


def _lines(one: NetworkCheck, allowed: int) -> list[str]:
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
