"""A node leaves the graph, also where the middleware hangs in its destruction."""

from __future__ import annotations

import signal
import subprocess
import sys

_HANGS = """
import ctypes
from taxinet_ros.nodes.running import leave

class Node:
    def destroy_node(self):
        ctypes.PyDLL(None).sleep(100)  # with Python's lock held, as in Fast DDS

leave._LIMIT_S = 0.2
leave.leave_graph(Node())
"""


def test_given_a_middleware_that_hangs_then_the_process_ends():
    done = subprocess.run([sys.executable, '-c', _HANGS], timeout=60, check=False)
    assert done.returncode == -signal.SIGALRM
