"""``taxinet bag replay``: replay a recorded run into one node and compare its outputs."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from taxinet_ros.analysis.one_run.replay import Difference, difference, plot_replay, quantities
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.run.trace import Column
from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL
from taxinet_ros.cli.bag.input import controller_of, perception_of, perception_words, readable_bags
from taxinet_ros.core.assurance.switch import parts_of
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.user_code import short_word
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.replay import replay
from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, new_folder

_COLUMNS = {
    interface.PERCEPTION: ('est_cte_m', 'est_he_rad'),
    interface.STEERING_CONTROLLER: ('steering_rad', 'speed_cmd_mps'),
    interface.MTL_MONITOR: (lower_column(''), upper_column('')),
}


@dataclass(frozen=True, kw_only=True)
class ReplayOptions:
    """Options of ``taxinet bag replay``.

    Attributes:
        recording: recording of the run.
        target: node to replay into.
        perception: word or file; None: the run's own.
        controller: word; None: the run's own.
        out: new folder for plot and table; None: one below ``bags/``.
        tolerance_cte_m, tolerance_he_deg: tolerances of estimates relative to the recording.
    """

    recording: Recording
    target: str
    perception: str | None
    controller: str | None
    out: Path | None
    tolerance_cte_m: float
    tolerance_he_deg: float

    def __post_init__(self) -> None:
        given = {'cte': self.tolerance_cte_m, 'he': self.tolerance_he_deg}
        for name, value in given.items():
            if not 0 <= value < float('inf'):
                raise UsageError(f'--tolerance-{name} {value:g}: needs to be 0 or more')
        if self.target != interface.PERCEPTION and (any(given.values()) or self.perception):
            raise UsageError(
                f'--into {self.target}: takes neither --perception nor a tolerance; its outputs '
                'are determined exactly by its inputs'
            )
        if self.target != interface.STEERING_CONTROLLER and self.controller:
            raise UsageError(f'--into {self.target}: takes no --controller')

    def tolerance(self, column: str) -> float:
        """Tolerance of a quantity in its display unit."""
        return {'est_cte_m': self.tolerance_cte_m, 'est_he_rad': self.tolerance_he_deg}.get(
            column, 0.0
        )

    def within(self, one: Difference) -> bool:
        """Whether a difference is within the tolerance; without one, it must be zero."""
        allowed = self.tolerance(one.quantity.column)
        return one.first_seq is None if allowed == 0 else one.greatest <= allowed


def run_replay(options: ReplayOptions) -> int:
    """Replay, print a table, and write plot and values; exit code 1 if different."""
    console = Console(highlight=False)
    with readable_bags():
        run, trace = options.recording.run, options.recording.columns
        if run.timing.free:
            raise UsageError(
                f'{options.recording.path}: a free run, whose unanswered frames cannot be '
                'compared; replay a lockstep run'
            )
        word, fingerprint = run.perception, run.fingerprint
        if options.target == interface.PERCEPTION:
            word, fingerprint = perception_of(run, options.perception)
        out = options.out or new_folder(_folder(run, options.target, word))
        check_new(out)
        controller = STEERING
        if options.target == interface.STEERING_CONTROLLER:
            controller = controller_of(run, options.controller)
            if parts_of(controller) is not None:
                raise UsageError(
                    f'--controller {controller}: its monitor needs the frames too, which are not '
                    'replayed into it; `taxinet run --from` drives the whole run again'
                )
        answers = replay(
            options.recording, run, target=options.target, perception=word, controller=controller
        )
    names = _names(run, options.target, word, fingerprint)
    found = [
        difference(quantity, trace, answers)
        for quantity in quantities(trace, _COLUMNS.get(options.target, ()))
    ]
    console.print(
        f'{run.request.run_id} into {options.target}: {names[0]}, {names[1]}', soft_wrap=True
    )
    _print(console, found, options)
    out.mkdir(parents=True, exist_ok=True)
    plot_replay(
        found, trace, out / 'replay.png', title=f'{run.request.run_id} into {options.target}',
        recorded=names[0], replayed=names[1],
    )
    _write_csv(found, trace, out / 'replay.csv')
    equal = all(options.within(one) for one in found)
    console.print(f'{_conclusion(found, equal)}; picture: {out / "replay.png"}, replay.csv',
                  soft_wrap=True)
    return EQUAL if equal else DIFFERENT


def _folder(run: RecordedRun, target: str, word: str) -> Path:
    what = short_word(word) if target == interface.PERCEPTION else target
    return DEFAULT_ROOT / f'replay-{run.request.run_id}-{what}'


def _names(run: RecordedRun, target: str, word: str, fingerprint: str) -> tuple[str, str]:
    """Labels of the recorded and the new outputs."""
    if target != interface.PERCEPTION:
        return 'recorded', 'now'
    before = perception_words(run.perception, run.fingerprint)
    return f'recorded: {before}', f'now: {perception_words(short_word(word), fingerprint)}'


def _print(console: Console, found: Sequence[Difference], options: ReplayOptions) -> None:
    heading = ('quantity', 'mean |Δ|', 'max |Δ|', 'allowed', 'equal steps', 'first other')
    rows = [heading, *(_cells(one, options) for one in found)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    styles = ['bold', *('' if options.within(one) else 'red' for one in found)]
    for row, style in zip(rows, styles, strict=True):
        line = f'{row[0]:<{widths[0]}}' + ''.join(
            f'  {cell:>{width}}' for cell, width in zip(row[1:], widths[1:], strict=True)
        )
        console.print(line, style=style, soft_wrap=True, markup=False)


def _cells(one: Difference, options: ReplayOptions) -> tuple[str, ...]:
    unit = f' {one.quantity.unit}' if one.quantity.unit else ''
    allowed = options.tolerance(one.quantity.column)
    first = '-' if one.first_seq is None else (
        f'step {one.first_seq} ({one.first_seq * CONTROL_PERIOD_NS / 1e9:.1f} s)'
    )
    return (
        one.quantity.label, f'{one.mean:.3g}{unit}', f'{one.greatest:.3g}{unit}',
        f'{allowed:g}{unit}' if allowed else 'no bit', f'{one.equal_steps} of {len(one.recorded)}',
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
            true = trace[quantity.truth].astype(np.float64) * quantity.scale
            columns[f'true_{name.removesuffix("_estimate")}{suffix}'] = true
    with path.open('w', newline='') as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
