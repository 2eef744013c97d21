"""Messages to core values and back, and the status messages that report faults of nodes.

Floats pass unchanged, so the graph matches the core's bits. The messages of every control step
are in :mod:`taxinet_ros.nodes.messages.step`.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from taxinet_msgs import msg as taxinet
from taxinet_msgs.msg import NodeStatus, RunStatus
from taxinet_msgs.msg import Timing as TimingMessage

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.camera import camera
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.outcome import Outcome, RunRequest
from taxinet_ros.core.pacing.free_run import FreeRun, FreeRunAccount
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import InfraError, InfraKind, plain_line
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import CAMERA_FRAME, MAP_FRAME


def time_of(stamp_ns: int) -> Time:
    """Nanoseconds since the start of the run as a ROS time."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def stamp_of(stamp: Time) -> int:
    """A ROS time as nanoseconds since the start of the run."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def header(stamp_ns: int, frame_id: str = MAP_FRAME) -> Header:
    """A header at simulated time ``stamp_ns``."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame_id)


def scenario_message(request: RunRequest) -> taxinet.Scenario:
    """The message that asks for a run."""
    return taxinet.Scenario(
        header=header(0),
        run_id=request.run_id,
        index=request.index,
        program=request.program,
        seed=request.seed,
        specs=list(request.judging.specs),
        stop_on=request.judging.stop_on,
        bounds=list(request.judging.bounds),
        rates=list(request.judging.rates),
        participants=list(request.participants),
        **dataclasses.asdict(request.scenario),
    )


def camera_info_message() -> CameraInfo:
    """Intrinsics of the wing camera at the start of a run."""
    matrix = camera.intrinsics()
    projection = np.hstack([matrix, np.zeros((3, 1))])
    return CameraInfo(
        header=header(0, CAMERA_FRAME),
        height=camera.IMAGE_HEIGHT,
        width=camera.IMAGE_WIDTH,
        distortion_model='plumb_bob',
        d=[0.0] * 5,
        k=matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def robustness_message(
    spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int, frame_id: str = MAP_FRAME
) -> taxinet.Robustness:
    """One formula's reading."""
    return taxinet.Robustness(
        header=header(stamp_ns, frame_id),
        run_id=run_id,
        seq=seq,
        spec=spec.name,
        formula=spec.text,
        rho_lower=reading.lower,
        rho_upper=reading.upper,
        verdict=int(reading.verdict),
        final=reading.final,
        valid=reading.valid,
        trusted=reading.trusted,
        samples=reading.samples,
        rejected=reading.rejected,
    )


def statistics_fields(statistics: RunStatistics) -> dict[str, Any]:
    """The fields of a verdict that hold the run's figures; the inverse of :func:`statistics_of`."""
    cte, he = statistics.cte_error, statistics.he_error
    return {
        'left_runway': statistics.left_runway,
        'max_cross_track_error': statistics.max_cross_track_m,
        'settle_time': statistics.settle_time_s,
        'estimate_cte_error_mean': cte.mean,
        'estimate_cte_error_mean_abs': cte.mean_abs,
        'estimate_cte_error_max_abs': cte.max_abs,
        'estimate_he_error_mean': he.mean,
        'estimate_he_error_mean_abs': he.mean_abs,
        'estimate_he_error_max_abs': he.max_abs,
        'unusable_estimates': statistics.unusable_estimates,
    }


def statistics_of(
    verdict: taxinet.Verdict, half_width_m: float = KMWH_HALF_WIDTH_M
) -> RunStatistics:
    """The run's figures in a verdict on a run along a runway of this half width [m]."""
    return RunStatistics(
        max_cross_track_m=verdict.max_cross_track_error,
        settle_time_s=verdict.settle_time,
        cte_error=ErrorStatistics(
            mean=verdict.estimate_cte_error_mean, mean_abs=verdict.estimate_cte_error_mean_abs,
            max_abs=verdict.estimate_cte_error_max_abs,
        ),
        he_error=ErrorStatistics(
            mean=verdict.estimate_he_error_mean, mean_abs=verdict.estimate_he_error_mean_abs,
            max_abs=verdict.estimate_he_error_max_abs,
        ),
        unusable_estimates=verdict.unusable_estimates,
        half_width_m=half_width_m,
    )


def settled_message(free: FreeRun, run_id: str) -> TimingMessage:
    """What becomes known with a frame: which earlier ones get no answer any more."""
    unestimated, uncommanded = free.settle()
    return TimingMessage(
        header=header(free.seq * CONTROL_PERIOD_NS, ''), run_id=run_id, seq=free.seq,
        unestimated=unestimated, uncommanded=uncommanded,
    )


def account_message(free: FreeRun, run_id: str) -> TimingMessage:
    """How a free run went, at its end."""
    account = free.account
    seq = max(free.seq, 0)
    return TimingMessage(
        header=header(seq * CONTROL_PERIOD_NS, ''), run_id=run_id, seq=seq, ended=True,
        applied=account.applied, frame_time=account.frame_s, estimate_time=account.estimate_s,
        command_time=account.command_s, estimate_seq=account.estimate_seq,
        command_seq=account.command_seq, overruns=account.overruns, stale=account.stale,
    )


def account_of(message: TimingMessage) -> FreeRunAccount:
    """The inverse of :func:`account_message`."""
    return FreeRunAccount(
        applied=list(message.applied), frame_s=list(message.frame_time),
        estimate_s=list(message.estimate_time), command_s=list(message.command_time),
        estimate_seq=list(message.estimate_seq), command_seq=list(message.command_seq),
        overruns=message.overruns, stale=message.stale,
    )


_BLAME = re.compile(rf'({InfraKind.INTRUDER}|{InfraKind.PROTOCOL}) (\S+): (.+)')
_KINDS = {NodeStatus.DIED: InfraKind.DIED, NodeStatus.ERROR: InfraKind.TIMEOUT}


def blame_text(error: InfraError) -> str:
    """The detail of an ERROR status by which a node charges another one."""
    return plain_line(f'{error.kind} {error.who}: {error.detail}')


def parse_blame(detail: str) -> tuple[str, str, str] | None:
    """Kind, who and what of a charge; None where a node speaks of itself."""
    found = _BLAME.fullmatch(detail)
    return (found[1], found[2], found[3]) if found else None


def same_ready(one: NodeStatus, other: NodeStatus) -> bool:
    """Whether two READYs of a node say the same of it; a node that comes back says it again."""
    return (one.implementation, one.fingerprint) == (other.implementation, other.fingerprint)


def duplicate_node_error(node: str) -> InfraError:
    """For a run in which READY came twice for a node, of two different ones."""
    return InfraError(
        InfraKind.INTRUDER, node, -1, 'two different nodes say that they are this one'
    )


def death_notice(
    run_id: str, name: str, detail: str, *, kind: str = InfraKind.DIED, seq: int = 0
) -> NodeStatus:
    """What somebody who looks after a node says to the nodes of a run, which then ends.

    Args:
        run_id: the run at hand.
        name: of the node.
        detail: how it ended, in a line.
        kind: ``died``, or ``timeout`` of a simulator that is given up.
        seq: control step that the run had reached, as far as is known.
    """
    state = next(state for state, known in _KINDS.items() if known == kind)
    return NodeStatus(
        header=header(seq * CONTROL_PERIOD_NS, ''), run_id=run_id, node=name, state=state,
        seq=seq, detail=detail,
    )


def lost_run_status(notice: NodeStatus) -> RunStatus:
    """How a run ends of whose simulator this was said: nobody else can tell any more."""
    return RunStatus(
        run_id=notice.run_id, state=RunStatus.ENDED, outcome=Outcome.INFRA_ERROR,
        kind=_KINDS.get(notice.state, InfraKind.DIED), who=interface.SIMULATOR,
        detail=notice.detail, seq=notice.seq,
    )


def one_line(error: BaseException) -> str:
    """Kind and first line of an exception."""
    return f'{type(error).__name__}: {error}'.splitlines()[0]
