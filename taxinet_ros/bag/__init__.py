"""Run bags: write, read, check, repair and decode them, without ROS.

Traces of a run as a table, on any machine with Python::

    from taxinet_ros.bag import open_recording

    run = open_recording('bags/campaign/s_falsif-s0-00000')
    trace = run.trace                        # a row per control step
    print(trace['cte_m'].abs().max(), trace.attrs['units']['cte_m'])
    odom = run.table('ground_truth/odom')
    odom.plot('t_s', 'pose.pose.position.y')

For an unfinished run these raise :class:`BagTruncated` with a one-line remedy; ``taxinet bag
recover`` repairs such a bag.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from taxinet_ros.bag.check.doctor import check_bag
    from taxinet_ros.bag.errors import (
        BagCorrupt,
        BagEmpty,
        BagError,
        BagForeign,
        BagTruncated,
        BagWriteError,
    )
    from taxinet_ros.bag.reader import read_attachment, read_info, read_messages
    from taxinet_ros.bag.run.recording import Recording, open_recording

__all__ = [
    'BagCorrupt',
    'BagEmpty',
    'BagError',
    'BagForeign',
    'BagTruncated',
    'BagWriteError',
    'Recording',
    'check_bag',
    'open_recording',
    'read_attachment',
    'read_info',
    'read_messages',
]

_HOME = {
    **dict.fromkeys(
        ('BagCorrupt', 'BagEmpty', 'BagError', 'BagForeign', 'BagTruncated', 'BagWriteError'),
        'errors',
    ),
    **dict.fromkeys(('read_attachment', 'read_info', 'read_messages'), 'reader'),
    **dict.fromkeys(('Recording', 'open_recording'), 'run.recording'),
    'check_bag': 'check.doctor',
}


def __getattr__(name: str) -> Any:
    """Import the names above lazily: a writer needs no pandas."""
    if name not in _HOME:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return getattr(importlib.import_module(f'{__name__}.{_HOME[name]}'), name)
