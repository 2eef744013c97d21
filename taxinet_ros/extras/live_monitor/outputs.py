"""Outputs of the standalone monitor: robustness, verdict, specs and diagnostics."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from taxinet_msgs.msg import Robustness, Verdict

from taxinet_ros.core.mtl import Spec
from taxinet_ros.extras.live_monitor.stretch import Level, Standing, standing_level, standing_line
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.messages.convert import robustness_message

# Reliable, as is the default. Only the newest message counts, also for late subscribers.
_NEWEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_EVERY = QoSProfile(depth=1000)
OUTPUTS = {
    'robustness': (Robustness, interface.ROBUSTNESS.name, _EVERY),
    'verdict': (Verdict, interface.VERDICT.name, _NEWEST),
    # JSON text (also valid YAML) in a message type that every tool displays.
    'specs': (String, 'monitor/specs', _NEWEST),
    # Absolute: robots collect all diagnostics there.
    'diagnostics': (DiagnosticArray, '/diagnostics', _EVERY),
}
"""Type, topic and quality of service of all outputs."""

_FIGURES = [
    name for name, kind in Verdict.get_fields_and_field_types().items() if kind == 'double'
]


def robustness_messages(
    specs: Sequence[Spec], standings: Sequence[Standing], stamp_ns: int, run_id: str, seq: int
) -> list[Robustness]:
    """One message per formula after sample ``seq`` of a stretch."""
    return [
        robustness_message(spec, standing.reading, run_id, seq, stamp_ns, frame_id='')
        for spec, standing in zip(specs, standings, strict=True)
    ]


def verdict_message(results: Sequence[Robustness]) -> Verdict:
    """Verdict over all formulas; statistics of a taxi run are NaN here.

    A formula whose windows hold no sample has the verdict UNKNOWN: the stretch is not complete.
    """
    newest = results[0]
    complete = all(
        result.final and result.valid and result.verdict != Robustness.UNKNOWN
        for result in results
    )
    return Verdict(
        header=newest.header,
        run_id=newest.run_id,
        specs=list(results),
        complete=complete,
        satisfied=complete and all(result.verdict == Robustness.SATISFIED for result in results),
        **dict.fromkeys(_FIGURES, math.nan),
    )


def specs_message(specs: Sequence[Spec], signals: Sequence[Any], **settings: Any) -> String:
    """Formulas and their inputs, as a message.

    Args:
        specs: the formulas.
        signals: for each signal a mapping of name, topic, type, field and factor.
        settings: sampling settings.
    """
    formulas = {spec.name: spec.text for spec in specs}
    document = {'specs': formulas, 'signals': list(signals), **settings}
    return String(data=json.dumps(document, allow_nan=False))


def spec_status(node: str, spec: Spec, standing: Standing, silence: str) -> DiagnosticStatus:
    """The diagnostic of one formula.

    Args:
        node: name of the node.
        spec: the formula.
        standing: its current result.
        silence: what samples are waiting for, or ''; this alone is a warning.
    """
    level, line = standing_level(standing), standing_line(standing)
    if silence:
        level, line = max(level, Level.WARN), f'{line}; {silence}'
    reading = standing.reading
    values = {
        'formula': spec.text, **reading.interval.by_end(),
        'samples': reading.samples, 'rejected': reading.rejected,
        **{f'part {number}': part for number, part in enumerate(standing.parts, start=1)},
    }
    return status(level, f'{node}: {spec.name}', line, values)


def status(level: Level, name: str, line: str, values: dict[str, Any]) -> DiagnosticStatus:
    """One diagnostic status."""
    return DiagnosticStatus(
        level=bytes([level]),
        name=name,
        message=line,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
    )
