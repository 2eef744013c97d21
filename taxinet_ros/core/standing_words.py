"""How a formula stands, for an operator: a level and a line."""

from __future__ import annotations

import enum

from taxinet_ros.core.mtl import Reading, Verdict
from taxinet_ros.core.stretch import Standing


class Level(enum.IntEnum):
    """How much a formula's standing matters; the numbers are those of ROS diagnostics."""

    OK = 0
    WARN = 1
    ERROR = 2


def standing_level(standing: Standing) -> Level:
    """ERROR violated or not valid, WARN 0 at best or an assumption broken, OK satisfied or open."""
    reading = standing.reading
    if not reading.valid or standing.decided is Verdict.VIOLATED:
        return Level.ERROR
    at_best_marginal = reading.upper == 0 or standing.decided is Verdict.MARGINAL
    return Level.WARN if at_best_marginal or standing.breach else Level.OK


def standing_line(standing: Standing) -> str:
    """E.g. ``violated at 3.2 s, rho within [-inf, -0.5]``."""
    words = _verdict(standing)
    if standing.reading.samples:
        words += f', {_rho(standing.reading)}'
    if standing.reading.final:
        words += ' (final)'
    if standing.breach:
        words += f'; an assumption broke {standing.breach}'
    return f'not valid, {standing.trouble}; before that {words}' if standing.trouble else words


def _verdict(standing: Standing) -> str:
    if standing.decided is Verdict.UNKNOWN:
        return 'open'
    return f'{standing.decided.name.lower()} at {standing.decided_s:g} s'


def _rho(reading: Reading) -> str:
    if reading.lower == reading.upper:
        return f'rho {reading.lower:+.4g}'
    return f'rho within [{reading.lower:+.4g}, {reading.upper:+.4g}]'
