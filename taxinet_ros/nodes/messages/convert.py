"""Convert messages to core values and back; status messages that report node errors.

Floats pass unchanged, so the graph matches the core's bits. The messages of every control step
are in :mod:`taxinet_ros.nodes.messages.step`.
"""

from __future__ import annotations

import math
import re

from builtin_interfaces.msg import Time
from std_msgs.msg import Header
from taxinet_msgs import msg as taxinet
from taxinet_msgs.msg import NodeStatus, RunStatus
from taxinet_msgs.msg import Timing as TimingMessage

from taxinet_ros.bag.run.message_values import reading_values, scenario_values
from taxinet_ros.core.mtl import Reading, Spec
from taxinet_ros.core.pacing.free_run import FreeRun
from taxinet_ros.core.place.runway import KMWH_HALF_WIDTH_M
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.core.verdict.run_statistics import SIGMA_FIGURES, ErrorStatistics, RunStatistics
from taxinet_ros.errors import InfraError, InfraKind, plain_line
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import MAP_FRAME


def time_of(stamp_ns: int) -> Time:
    """Convert nanoseconds since the start of the run to a ROS time."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def stamp_of(stamp: Time) -> int:
    """Convert a ROS time to nanoseconds since the start of the run."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def header(stamp_ns: int, frame_id: str = MAP_FRAME) -> Header:
    """Header at simulated time ``stamp_ns``."""
    return Header(stamp=time_of(stamp_ns), frame_id=frame_id)


def scenario_message(request: RunRequest) -> taxinet.Scenario:
    """Message that requests a run."""
    return taxinet.Scenario(header=header(0), **scenario_values(request))


def robustness_message(
    spec: Spec, reading: Reading, run_id: str, seq: int, stamp_ns: int, frame_id: str = MAP_FRAME
) -> taxinet.Robustness:
    """Current robustness of one formula."""
    return taxinet.Robustness(
        header=header(stamp_ns, frame_id), **reading_values(spec, reading, run_id, seq)
    )


def statistics_of(
    verdict: taxinet.Verdict, half_width_m: float = KMWH_HALF_WIDTH_M
) -> RunStatistics:
    """Statistics of the run in a verdict, along a runway of this half width [m]."""
    return RunStatistics(
        max_cross_track_m=verdict.max_cross_track_error,
        settle_time_s=verdict.settle_time,
        cte_error=ErrorStatistics(
            mean=verdict.estimate_cte_error_mean, mean_abs=verdict.estimate_cte_error_mean_abs,
            max_abs=verdict.estimate_cte_error_max_abs, **_sigma_figures(verdict, 'cte'),
        ),
        he_error=ErrorStatistics(
            mean=verdict.estimate_he_error_mean, mean_abs=verdict.estimate_he_error_mean_abs,
            max_abs=verdict.estimate_he_error_max_abs, **_sigma_figures(verdict, 'he'),
        ),
        unusable_estimates=verdict.unusable_estimates,
        half_width_m=half_width_m,
    )


def _sigma_figures(verdict: taxinet.Verdict, name: str) -> dict[str, float]:
    values = {figure: getattr(verdict, f'{name}_{figure}') for figure in SIGMA_FIGURES}
    # One NaN, as in the loop, so that equal statistics compare as such.
    return {figure: math.nan if math.isnan(one) else one for figure, one in values.items()}


def account_message(free: FreeRun, run_id: str, stamp_ns: int) -> TimingMessage:
    """Message with the account of a free run, at its end."""
    account = free.account
    return TimingMessage(
        header=header(stamp_ns, ''), run_id=run_id, seq=max(free.seq, 0), ended=True,
        applied=account.applied, frame_time=account.frame_s, estimate_time=account.estimate_s,
        command_time=account.command_s, estimate_seq=account.estimate_seq,
        command_seq=account.command_seq, overruns=account.overruns, stale=account.stale,
    )


_BLAME = re.compile(rf'({InfraKind.INTRUDER}|{InfraKind.PROTOCOL}) (\S+): (.+)')
_KINDS = {NodeStatus.DIED: InfraKind.DIED, NodeStatus.ERROR: InfraKind.TIMEOUT}


def blame_text(error: InfraError) -> str:
    """Detail of an ERROR status by which a node reports another one's error."""
    return plain_line(f'{error.kind} {error.who}: {error.detail}')


def parse_blame(detail: str) -> tuple[str, str, str] | None:
    """Parse kind, node and detail of such a report; None if a node reports its own error."""
    found = _BLAME.fullmatch(detail)
    return (found[1], found[2], found[3]) if found else None


def same_ready(one: NodeStatus, other: NodeStatus) -> bool:
    """Whether two READY messages of a node are equal; a node repeats its READY."""
    return (one.implementation, one.fingerprint) == (other.implementation, other.fingerprint)


def death_notice(
    run_id: str, name: str, detail: str, *, kind: str = InfraKind.DIED, seq: int = 0,
    stamp_ns: int = 0,
) -> NodeStatus:
    """Message that reports a dead node, or one that timed out, to a run, which then ends."""
    state = next(state for state, known in _KINDS.items() if known == kind)
    return NodeStatus(
        header=header(stamp_ns, ''), run_id=run_id, node=name, state=state, seq=seq,
        detail=detail,
    )


def lost_run_status(notice: NodeStatus) -> RunStatus:
    """Final status of a run whose simulator was reported dead."""
    return RunStatus(
        run_id=notice.run_id, state=RunStatus.ENDED, outcome=Outcome.INFRA_ERROR,
        kind=_KINDS.get(notice.state, InfraKind.DIED), who=interface.SIMULATOR,
        detail=notice.detail, seq=notice.seq,
    )


def one_line(error: BaseException) -> str:
    """Type and first line of an exception."""
    return f'{type(error).__name__}: {error}'.splitlines()[0]
