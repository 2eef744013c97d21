"""``taxinet bag replay``: replay a recorded run into one node and compare its outputs."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from taxinet_ros.cli.options import BagArgument, OwnControllerOption, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.core.topics import MTL_MONITOR, PERCEPTION, STEERING_CONTROLLER
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from taxinet_ros.analysis.one_run.replay import Difference
    from taxinet_ros.bag.run.facts import RecordedRun
    from taxinet_ros.bag.run.recording import Recording
    from taxinet_ros.bag.run.trace import Column

_COLUMNS = {
    PERCEPTION: ('est_cte_m', 'est_he_rad'),
    STEERING_CONTROLLER: ('steering_rad', 'speed_cmd_mps'),
    MTL_MONITOR: ('rho_lower.', 'rho_upper.'),
}
"""Columns of a run's trace that a node fills, by its name."""


def replay(
    bag: BagArgument,
    into: Annotated[
        str,
        typer.Option(metavar='NODE', help='perception, steering_controller or mtl_monitor'),
    ] = 'perception',
    run_id: RunOption = None,
    perception: Annotated[
        str | None,
        typer.Option(
            help="replaces the run's perception: a word, weights file, .onnx network or "
            'FILE.py:NAME'
        ),
    ] = None,
    controller: OwnControllerOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='new folder for plot and table (default: below bags/)'),
    ] = None,
    tolerance_cte: Annotated[
        float,
        typer.Option(
            metavar='M', help='tolerance of cross-track estimates; 0: bit-identical'
        ),
    ] = 0.0,
    tolerance_he: Annotated[
        float,
        typer.Option(
            metavar='DEG', help='tolerance of heading estimates; 0: bit-identical'
        ),
    ] = 0.0,
) -> int:
    """Replay a recorded run into one node and compare its outputs.

    Regression test for a retrained network. Missing frames are rendered. Exit code: 0 equal within
    the tolerances, 1 different, 2 bad input, 4 the node failed.
    """
    from taxinet_ros.trials.past_runs.repeated_run import readable_run

    tolerances = {'cte': tolerance_cte, 'he': tolerance_he}
    for name, value in tolerances.items():
        if not 0 <= value < float('inf'):
            raise UsageError(f'--tolerance-{name} {value:g}: needs to be 0 or more')
    if into != PERCEPTION and (any(tolerances.values()) or perception):
        raise UsageError(
            f'--into {into}: takes neither --perception nor a tolerance; its outputs '
            'are determined exactly by its inputs'
        )
    if into != STEERING_CONTROLLER and controller:
        raise UsageError(f'--into {into}: takes no --controller')
    with readable_run(bag, run_id) as whole:
        return run_replay(
            whole, into, perception=perception, controller=controller, out=out,
            allowed={'est_cte_m': tolerance_cte, 'est_he_rad': tolerance_he},
        )


def run_replay(
    recording: Recording, into: str, *, perception: str | None, controller: str | None,
    out: Path | None, allowed: Mapping[str, float],
) -> int:
    """Replay, print a table, and write plot and values; exit code 1 if different.

    Args:
        recording: of the run.
        into: the node.
        perception: word; None for the run's own.
        controller: word; None for the run's own.
        out: new folder, or None for one below ``bags/``.
        allowed: greatest differences by column, in display units; of others 0.
    """
    from taxinet_ros.analysis.one_run.replay import difference, plot_replay, quantities
    from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL
    from taxinet_ros.core.assurance.switch import parts_of
    from taxinet_ros.core.motion.controller import STEERING
    from taxinet_ros.nodes.graph.replay import replay
    from taxinet_ros.trials.options import check_new, new_folder
    from taxinet_ros.trials.past_runs.repeated_run import controller_of, perception_of

    console = line_console()
    run, trace = recording.run, recording.columns
    if run.timing.free:
        raise UsageError(
            f'{recording.path}: a free run, whose unanswered frames cannot be compared; replay a '
            'lockstep run'
        )
    word, fingerprint = run.perception, run.fingerprint
    if into == PERCEPTION:
        word, fingerprint = perception_of(run, perception)
    out = out or new_folder(_folder(run, into, word))
    check_new(out)
    law = STEERING
    if into == STEERING_CONTROLLER:
        law = controller_of(run, controller)
        if parts_of(law) is not None:
            raise UsageError(
                f'--controller {law}: its monitor needs the frames too, which are not '
                'replayed into it; `taxinet run --from` drives the whole run again'
            )
    answers = replay(recording, run, target=into, perception=word, controller=law)
    names = _names(run, into, word, fingerprint)
    found = [
        difference(quantity, trace, answers)
        for quantity in quantities(trace, _COLUMNS.get(into, ()))
    ]
    console.print(f'{run.request.run_id} into {into}: {names[0]}, {names[1]}')
    _print(console, found, allowed)
    out.mkdir(parents=True, exist_ok=True)
    plot_replay(
        found, trace, out / 'replay.png', title=f'{run.request.run_id} into {into}',
        recorded=names[0], replayed=names[1],
    )
    _write_csv(found, trace, out / 'replay.csv')
    equal = all(_within(one, allowed) for one in found)
    console.print(f'{_conclusion(found, equal)}; picture: {out / "replay.png"}, replay.csv')
    return EQUAL if equal else DIFFERENT


def _within(one: Difference, allowed: Mapping[str, float]) -> bool:
    """Whether a difference is within the tolerance; without one, it must be zero."""
    most = allowed.get(one.quantity.column, 0.0)
    return one.first_seq is None if most == 0 else one.greatest <= most


def _folder(run: RecordedRun, target: str, word: str) -> Path:
    from taxinet_ros.core.user_code import short_word
    from taxinet_ros.trials.options import DEFAULT_ROOT

    what = short_word(word) if target == PERCEPTION else target
    return DEFAULT_ROOT / f'replay-{run.request.run_id}-{what}'


def _names(run: RecordedRun, target: str, word: str, fingerprint: str) -> tuple[str, str]:
    """Labels of the recorded and the new outputs."""
    from taxinet_ros.core.user_code import short_word
    from taxinet_ros.trials.past_runs.repeated_run import perception_words

    if target != PERCEPTION:
        return 'recorded', 'now'
    before = perception_words(run.perception, run.fingerprint)
    return f'recorded: {before}', f'now: {perception_words(short_word(word), fingerprint)}'


def _print(
    console: Console, found: Sequence[Difference], allowed: Mapping[str, float]
) -> None:
    heading = ('quantity', 'mean |Δ|', 'max |Δ|', 'allowed', 'equal steps', 'first other')
    rows = [heading, *(_cells(one, allowed) for one in found)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    styles = ['bold', *('' if _within(one, allowed) else 'red' for one in found)]
    for row, style in zip(rows, styles, strict=True):
        line = f'{row[0]:<{widths[0]}}' + ''.join(
            f'  {cell:>{width}}' for cell, width in zip(row[1:], widths[1:], strict=True)
        )
        console.print(line, style=style)


def _cells(one: Difference, allowed: Mapping[str, float]) -> tuple[str, ...]:
    from taxinet_ros.core.control_step import CONTROL_PERIOD_NS

    unit = f' {one.quantity.unit}' if one.quantity.unit else ''
    most = allowed.get(one.quantity.column, 0.0)
    first = '-' if one.first_seq is None else (
        f'step {one.first_seq} ({one.first_seq * CONTROL_PERIOD_NS / 1e9:.1f} s)'
    )
    return (
        one.quantity.label, f'{one.mean:.3g}{unit}', f'{one.greatest:.3g}{unit}',
        f'{most:g}{unit}' if most else 'no bit', f'{one.equal_steps} of {len(one.recorded)}',
        first,
    )


def _conclusion(found: Sequence[Difference], equal: bool) -> str:
    if all(one.first_seq is None for one in found):
        return 'bit-identical'
    return 'the same within the tolerance' if equal else 'different'


def _write_csv(
    found: Sequence[Difference], trace: Mapping[str, Column], path: Path
) -> None:
    """Write one row per step: recorded, replayed and true values, in display units."""
    columns: dict[str, NDArray[np.generic]] = {'seq': trace['seq']}
    for one in found:
        quantity = one.quantity
        name = quantity.label.replace(' ', '_').replace('-', '_')
        suffix = f'_{quantity.unit.replace("/", "p")}' if quantity.unit else ''
        columns[f'recorded_{name}{suffix}'] = one.recorded
        columns[f'replayed_{name}{suffix}'] = one.replayed
        if quantity.truth:
            true = trace[quantity.truth].astype('float64') * quantity.scale
            columns[f'true_{name.removesuffix("_estimate")}{suffix}'] = true
    with path.open('w', newline='') as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
