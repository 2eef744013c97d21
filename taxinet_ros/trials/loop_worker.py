"""Worker process of a campaign without ROS: runs closed loops one by one.

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

from taxinet_ros.core.system import system_values
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.processes.child import module_command
from taxinet_ros.trials.audit import Auditor
from taxinet_ros.trials.loop_run import Loop, LoopOptions
from taxinet_ros.trials.worker_pool import encode_line, request_from_json, result_to_json

_BEAT_S = 1.0


def loop_worker_command(
    options: LoopOptions, audit_percent: float = 0.0, audit_command: Sequence[str] = ()
) -> list[str]:
    """Command line of a worker.

    Args:
        options: options of its loop.
        audit_percent: share of the runs to audit [%].
        audit_command: command of the graph's worker for audits, see :class:`.Auditor`.
    """
    values = {**options.to_json(), 'out': None if options.out is None else str(options.out)}
    return module_command(
        'taxinet_ros.trials.loop_worker', f'--options={json.dumps(values)}',
        f'--audit-percent={audit_percent}', f'--audit-command={json.dumps(list(audit_command))}',
    )


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
    out = None if values['out'] is None else Path(values['out'])
    loop = Loop(LoopOptions(**{**system_values(values), 'out': out}))
    told_s = time.monotonic()

    def say(**message: Any) -> None:
        os.write(arguments.answers, encode_line(message))

    def beat(seq: int) -> None:
        # Silence is taken for a hang.
        nonlocal told_s
        if time.monotonic() - told_s > _BEAT_S:
            told_s = time.monotonic()
            say(seq=seq)

    percent = arguments.audit_percent if out is not None else 0.0
    command = json.loads(arguments.audit_command)
    with Auditor(lambda: command, out or Path(), percent) as auditor:
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
    parser.add_argument('--audit-percent', type=float, required=True)
    parser.add_argument('--audit-command', required=True)
    return parser.parse_args(words)


if __name__ == '__main__':
    sys.exit(main())
