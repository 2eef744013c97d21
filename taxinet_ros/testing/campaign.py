"""Campaigns as tests: scenes, a node or a function, and the share that has to be satisfied."""

from __future__ import annotations

import functools
import itertools
import shlex
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from taxinet_ros.api.campaign import Campaign, open_campaign
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.processes.child import module_command, package_environment
from taxinet_ros.trials.summary import row_line

_TAXINET = 'taxinet_ros.cli.start', 'taxinet_ros.cli.main'
_MOST_SHOWN = 10


def run_campaign(
    program: str, *, runs: int, at_least: float, perception: str = 'taxinet',
    controller: str = 'steering', seed: int = 0, specs: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None, workers: int = 1, domain: int | None = None,
    folder: Path | None = None,
) -> Campaign:
    """Run the first scenes of a program, as ``taxinet run`` does, and judge how many are satisfied.

    The scenes depend on the program and the seed alone. Nodes get a ROS domain of their own, which
    is limited to this machine; functions and networks run in the closed loop without ROS, with the
    same results.

    Args:
        program: shipped Scenic program, or path of one.
        runs: number of scenes.
        at_least: share of scenes that have to be satisfied, 0 to 1.
        perception: name, file, ``FILE.py:NAME``, ``cmd:COMMAND`` of a node, or ``external`` for one
            that somebody else starts on ``domain``.
        controller: likewise.
        seed: seed of the scenes.
        specs: requirements; the first is the headline.
        settings: scenario values, as for ``--set``.
        workers: runs at a time; same results.
        domain: ROS domain; None for a free one.
        folder: where the campaign's folder is made; None for a temporary one, which is kept.

    Returns:
        The campaign, with all rows, and its rate with an interval.

    Raises:
        AssertionError: too few scenes are satisfied, or one could not be judged.
        UsageError: an argument is invalid.
    """
    __tracebackhide__ = True
    if not 0 < at_least <= 1:
        raise UsageError(f'at_least={at_least}: a share, within 0..1')
    folder = Path(tempfile.mkdtemp(prefix='taxinet-')) if folder is None else folder
    out = next(
        path for number in itertools.count(1)
        if not (path := folder / f'campaign-{number}').exists()
    )
    system = ['--perception', perception, '--controller', controller]
    words = [
        'run', program, *system, '--runs', str(runs), '--seed', str(seed), '--workers',
        str(workers), '--images', 'none', '--out', str(out), '--quiet',
        *(word for spec in specs for word in ('--spec', spec)),
        *(word for key, value in (settings or {}).items() for word in ('--set', f'{key}={value}')),
    ]
    if not any(map(is_node_elsewhere, (perception, controller))):
        words += ['--engine', 'loop', '--audit', '0']
    done = subprocess.run(
        module_command(*_TAXINET, *words), env=_environment(domain), capture_output=True, text=True,
        check=False,
    )
    if done.returncode in (ExitCode.USAGE, ExitCode.INTERRUPTED) or not out.exists():
        said = (done.stderr.strip() or f'exit code {done.returncode}').splitlines()[-1]
        raise UsageError(said.removeprefix('taxinet: error: '))
    campaign = open_campaign(out)
    _judge(campaign, runs, at_least, shlex.join(system))
    return campaign


def _environment(domain: int | None) -> dict[str, str]:
    """Environment in which nodes neither meet others nor are met."""
    domains = {} if domain is None else {'TAXINET_DOMAIN_ID': str(domain)}
    ours = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', **domains}
    others = ('ROS_STATIC_PEERS', 'TAXINET_DOMAIN_ID')
    kept = {name: value for name, value in package_environment().items() if name not in others}
    return {**kept, **ours}


def _judge(campaign: Campaign, runs: int, at_least: float, system: str) -> None:
    """Raise if too few scenes are satisfied, with those that are not, and how to repeat one."""
    __tracebackhide__ = True
    rows = sorted(campaign.recorded.rows, key=lambda row: row.index)
    wrong = [row for row in rows if row.outcome is not Outcome.PASS]
    unclear = runs - sum(row.outcome.judged for row in rows)
    passed = len(rows) - len(wrong)
    # Not at_least * runs: 0.56 * 25 is above 14, while 14 / 25 is 0.56.
    if not unclear and passed / runs >= at_least:
        return
    rate = campaign.rates['failed'].rate
    interval = f' (95 % interval {rate.other.low:.0%}-{rate.other.high:.0%})' if rate else ''
    failed = next((row for row in wrong if row.bag), None)
    raise AssertionError('\n'.join([
        f'{passed} of {runs} scenes of {campaign.facts["program"]} satisfied{interval}, '
        f'{100 * at_least:g}% wanted; {unclear} without a verdict',
        *(row_line(row).plain for row in wrong[:_MOST_SHOWN]),
        *([f'and {len(wrong) - _MOST_SHOWN} more'] if len(wrong) > _MOST_SHOWN else []),
        *([f'to repeat one: taxinet run --from {shlex.quote(str(campaign.folder / failed.bag))} '
           f'{system}'] if failed else []),
        f'to find the causes: taxinet why {shlex.quote(str(campaign.folder))}',
    ]))


def launch_test(*actions: Any) -> tuple[Any, dict[str, Any]]:
    """What ``generate_test_description()`` of launch_testing returns, for nodes of one's own.

    Actions start the nodes, on a ROS domain of their own that is limited to this machine. Tests get
    the argument ``taxinet_campaign``, :func:`run_campaign` on that domain, which takes them as
    ``perception='external'`` or ``controller='external'``.

    Args:
        actions: of launch and launch_ros, which are imported here alone.
    """
    from taxinet_ros.nodes.running.domain import own_domain

    launch, actions_of_launch, testing = map(
        import_module, ('launch', 'launch.actions', 'launch_testing.actions')
    )
    with own_domain() as domain:  # the nodes, which begin now, keep it
        variables = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    return launch.LaunchDescription([
        *(actions_of_launch.SetEnvironmentVariable(*one) for one in variables.items()), *actions,
        testing.ReadyToTest(),
    ]), {'taxinet_campaign': functools.partial(run_campaign, domain=domain)}
