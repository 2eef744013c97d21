"""What is said of a node by others: that it is dead, or silent, or did wrong."""

from __future__ import annotations

import re

from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import InfraError, plain_line
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.convert import header

INTRUDER = 'intruder'
"""Kind of an error of a run in which somebody else speaks."""

PROTOCOL = 'protocol'
"""Kind of an error of a node that does not keep to the lockstep."""

_CHARGE = re.compile(rf'({INTRUDER}|{PROTOCOL}) (\S+): (.+)')
_KINDS = {NodeStatus.DIED: 'died', NodeStatus.ERROR: 'timeout'}


def charge(error: InfraError) -> str:
    """The detail of an ERROR status by which a node charges another one."""
    return plain_line(f'{error.kind} {error.who}: {error.detail}')


def charged(detail: str) -> tuple[str, str, str] | None:
    """Kind, who and what of a charge; None where a node speaks of itself."""
    found = _CHARGE.fullmatch(detail)
    return (found[1], found[2], found[3]) if found else None


def same_ready(one: NodeStatus, other: NodeStatus) -> bool:
    """Whether two READYs of a node say the same of it; a node that comes back says it again."""
    return (one.implementation, one.fingerprint) == (other.implementation, other.fingerprint)


def two_of_a_name(node: str) -> InfraError:
    """For a run in which READY came twice for a node, of two different ones."""
    return InfraError(INTRUDER, node, -1, 'two different nodes say that they are this one')


def obituary(
    run_id: str, name: str, detail: str, *, kind: str = 'died', seq: int = 0
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


def lost_run(notice: NodeStatus) -> RunStatus:
    """How a run ends of whose simulator this was said: nobody else can tell any more."""
    return RunStatus(
        run_id=notice.run_id, state=RunStatus.ENDED, outcome=Outcome.INFRA_ERROR,
        kind=_KINDS.get(notice.state, 'died'), who=interface.SIMULATOR, detail=notice.detail,
        seq=notice.seq,
    )
