"""Worker process without ROS: runs closed loops one by one.

Started by :class:`taxinet_ros.trials.worker_pool.WorkerProcess`.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.core.system import System
from taxinet_ros.files.plain_values import typed
from taxinet_ros.processes.child import module_command
from taxinet_ros.trials.worker_pool import Link, serve


def loop_worker_command(
    system: System | None = None, out: Path | None = None, images: str = 'none', *,
    audit_percent: float = 0.0, audit_command: Sequence[str] = (),
) -> list[str]:
    """Command line of a worker.

    Args:
        system: as of :class:`.Loop`.
        out: likewise.
        images: likewise.
        audit_percent: share of the runs to audit [%].
        audit_command: command of the graph's worker for audits, see :class:`.Auditor`.
    """
    values = {
        'system': None if system is None else dataclasses.asdict(system),
        'out': None if out is None else str(out), 'images': images,
        'audit_percent': audit_percent, 'audit_command': list(audit_command),
    }
    return module_command('taxinet_ros.trials.loop_worker', f'--options={json.dumps(values)}')


def _work(options: dict[str, Any], link: Link) -> None:
    import cv2
    from threadpoolctl import threadpool_limits

    from taxinet_ros.trials.audit import Auditor
    from taxinet_ros.trials.loop_run import Loop

    cv2.setNumThreads(1)  # the workers share the cores among themselves
    threadpool_limits(limits=1)
    system = None if options['system'] is None else typed(System, options['system'])
    out = None if options['out'] is None else Path(options['out'])
    loop = Loop(system, out, options['images'])
    link.interrupt = loop.interrupt
    percent = options['audit_percent'] if out is not None else 0.0
    with Auditor(lambda: options['audit_command'], out or Path(), percent) as auditor:
        for request in link.requests():
            result = loop.run(request, link.progress)
            link.answer(request, auditor.audited(request, result, link.progress))


if __name__ == '__main__':
    sys.exit(serve(_work))
