"""What is said in a graph when a node's process is known to be dead, by whoever knows."""

from __future__ import annotations

from taxinet_msgs.msg import NodeStatus, RunStatus

from taxinet_ros.core.outcome import Outcome
from taxinet_ros.nodes import interface


def node_died(run_id: str, name: str, detail: str) -> NodeStatus:
    """To the simulator, which then ends the run."""
    return NodeStatus(run_id=run_id, node=name, state=NodeStatus.DIED, detail=detail)


def simulator_lost(run_id: str, kind: str, detail: str, seq: int) -> RunStatus:
    """In the simulator's stead, for nobody else can tell sampler and recorder of the run's end."""
    return RunStatus(
        run_id=run_id, state=RunStatus.ENDED, outcome=Outcome.INFRA_ERROR, kind=kind,
        who=interface.SIMULATOR, detail=detail, seq=seq,
    )
