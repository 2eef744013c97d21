"""Remove a node from the graph without hanging in Fast DDS.

``rmw_fastrtps`` removes its participant's listener before the participant, and Fast DDS 2.14 waits
there without a limit for discovery callbacks under way, which happen just when other nodes leave
too. Its wait for the latest possible time overflows: ``pthread_cond_timedwait`` refuses such a time
without releasing the lock that the callbacks need, and is called again for ever, with Python's
global lock held. Given a limit, it waits as it should, and the listener is gone before
``rmw_fastrtps`` asks. (``DomainParticipant::set_listener`` of ``DomainParticipant.cpp``.)
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

from rclpy.utilities import get_rmw_implementation_identifier

_WAIT_S, _WAITS = 1, 10
"""Time limit of one wait for callbacks [s], and how many: a busy machine needs more."""
_PARTICIPANT = '_ZN16rmw_fastrtps_cpp22get_domain_participantEP10rmw_node_s'
_SET_LISTENER = (
    '_ZN8eprosima7fastdds3dds17DomainParticipant12set_listener'
    'EPNS1_25DomainParticipantListenerENSt6chrono8durationIlSt5ratioILl1ELl1EEEE'
)


def leave_graph(node: Any) -> None:
    """Destroy a node, which may be the last one of its context.

    Others of its context no longer notice who comes and goes, so they should leave as well.
    """
    _end_discovery(node)
    node.destroy_node()


def _end_discovery(node: Any) -> None:
    """Remove the listener of a node's participant, when no discovery callback is under way."""
    calls = _calls()
    if calls is None:
        return
    rmw_node, participant_of, set_listener = calls
    with node.handle:
        participant = participant_of(rmw_node(node.handle.pointer))
        for _ in range(_WAITS):
            if not participant or not set_listener(participant, None, _WAIT_S):
                return


@functools.cache
def _calls() -> tuple[Any, Any, Any] | None:
    """Functions of rcl, rmw_fastrtps and Fast DDS 2; None with another DDS."""
    if get_rmw_implementation_identifier() != 'rmw_fastrtps_cpp':
        return None
    try:
        # Loaded already, so their names suffice.
        rcl, rmw, dds = (
            ctypes.CDLL(name) for name in ('librcl.so', 'librmw_fastrtps_cpp.so',
                                           'libfastrtps.so.2.14')
        )
        rmw_node, participant = rcl.rcl_node_get_rmw_handle, rmw[_PARTICIPANT]
        set_listener = dds[_SET_LISTENER]
    except (OSError, AttributeError):
        return None
    for function in (rmw_node, participant):
        function.argtypes, function.restype = [ctypes.c_void_p], ctypes.c_void_p
    set_listener.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_long]
    set_listener.restype = ctypes.c_uint32
    return rmw_node, participant, set_listener
