"""Whether an answer of the control loop can be one, before time moves on with it."""

from __future__ import annotations

import math

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import InfraError
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.nodes.notices import PROTOCOL
from taxinet_ros.nodes.reading import Said


def check_answer(answer: Said, who: str, seq: int) -> None:
    """See that an answer is to a frame that is out. A late or repeated one is nothing bad.

    Args:
        answer: an estimate or a command.
        who: node that gave it.
        seq: the newest frame.

    Raises:
        InfraError: it is to a frame still to come, or contradicts itself about which.
    """
    if answer.seq > seq:
        detail = f'answered frame {answer.seq}, which is not out yet'
        raise InfraError(PROTOCOL, who, seq, detail)
    if answer.stamp_ns != answer.seq * CONTROL_PERIOD_NS:
        detail = f'its answer to frame {answer.seq} is stamped {answer.stamp_ns / 1e9:g} s'
        raise InfraError(PROTOCOL, who, seq, detail)


def check_command(command: TaxiCommand, who: str, seq: int) -> None:
    """See that an aircraft can follow the command that a node gave as its answer to a frame.

    Raises:
        InfraError: the angle is not finite, or the speed is not, or is negative.
    """
    if not (math.isfinite(command.steering_rad) and 0 <= command.speed_mps < math.inf):
        detail = f'commanded {command.steering_rad:g} rad at {command.speed_mps:g} m/s'
        raise InfraError(PROTOCOL, who, seq, detail)
