"""Worker process without ROS: runs closed loops one by one.

Started by :class:`taxinet_ros.trials.worker_pool.WorkerProcess`, which defines the pipe protocol.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
from threadpoolctl import threadpool_limits

from taxinet_ros.core.system import System, system_values
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.processes.child import module_command
from taxinet_ros.trials.audit import Auditor
from taxinet_ros.trials.loop_run import Loop
from taxinet_ros.trials.worker_pool import encode_line, request_from_json, result_to_json

_BEAT_S = 1.0


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
        'system': None if system is None else system.to_json(),
        'out': None if out is None else str(out), 'images': images,
        'audit_percent': audit_percent, 'audit_command': list(audit_command),
    }
    return module_command('taxinet_ros.trials.loop_worker', f'--options={json.dumps(values)}')


def main(words: Sequence[str] | None = None) -> int:
    """Serve run requests until the input ends.

    Returns:
        Exit code: 0, or 2 after a usage error.
    """
    arguments = _arguments(words)
    cv2.setNumThreads(1)  # the workers share the cores among themselves
    threadpool_limits(limits=1)
    try:
        _work(arguments)
    except UsageError as error:
        os.write(arguments.answers, encode_line({'error': str(error)}))
        return ExitCode.USAGE
    return ExitCode.OK


def _work(arguments: argparse.Namespace) -> None:
    values = json.loads(arguments.options)
    system = None if values['system'] is None else System(**system_values(values['system']))
    out = None if values['out'] is None else Path(values['out'])
    loop = Loop(system, out, values['images'])
    told_s = time.monotonic()

    def say(**message: Any) -> None:
        os.write(arguments.answers, encode_line(message))

    def beat(seq: int) -> None:
        # Silence is taken for a hang.
        nonlocal told_s
        if time.monotonic() - told_s > _BEAT_S:
            told_s = time.monotonic()
            say(seq=seq)

    percent = values['audit_percent'] if out is not None else 0.0
    with Auditor(lambda: values['audit_command'], out or Path(), percent) as auditor:
        for line in sys.stdin.buffer:
            message = json.loads(line)
            if 'run' not in message:
                return  # an interrupt: the current run has ended
            request = request_from_json(message['run'])
            result = auditor.audited(request, loop.run(request, beat), beat)
            say(result=result_to_json(result))


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument('--answers', type=int, required=True)
    parser.add_argument('--options', required=True)
    return parser.parse_args(words)


if __name__ == '__main__':
    sys.exit(main())
