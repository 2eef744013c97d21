"""Worker process of a search: one composed graph for many runs.

Started by :class:`taxinet_ros.trials.worker_pool.WorkerProcess`, which defines the pipe protocol;
Linux kills the worker when its parent dies.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import os
import queue
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.processes.child import module_command

if TYPE_CHECKING:
    from taxinet_ros.core.system import System
    from taxinet_ros.core.verdict.outcome import RunRequest, RunResult
    from taxinet_ros.nodes.graph.runner import GraphOptions, SampledGraph
    from taxinet_ros.trials.options import CampaignOptions

_BEAT_S = 1.0


def campaign_worker_command(campaign: CampaignOptions, facts: Mapping[str, Any]) -> list[str]:
    """Command line of a worker for the runs of a campaign, by its engine."""
    from taxinet_ros.nodes.graph.runner import campaign_graph
    from taxinet_ros.trials.loop_worker import loop_worker_command
    from taxinet_ros.trials.options import GRAPH
    from taxinet_ros.trials.record.facts import recorded_system

    system = recorded_system(campaign, facts)
    if campaign.engine == GRAPH:
        return worker_command(campaign_graph(campaign, system))
    return loop_worker_command(
        system, campaign.bag_folder, campaign.images, audit_percent=campaign.audit_percent,
        audit_command=audit_command(campaign, system),
    )


def audit_command(campaign: CampaignOptions, system: System) -> list[str]:
    """Command line of a worker that repeats runs of a campaign for :class:`.Auditor`."""
    from taxinet_ros.nodes.graph.runner import campaign_graph
    from taxinet_ros.trials.options import AUDIT_FOLDER

    graph = campaign_graph(campaign, system)
    return worker_command(dataclasses.replace(graph, out=campaign.out / AUDIT_FOLDER))


def worker_command(options: GraphOptions) -> list[str]:
    """Command line of a worker with a graph, in a folder that exists."""
    values = {**options.to_json(), 'out': str(options.out), 'make_out': False}
    return module_command('taxinet_ros.nodes.graph.worker', f'--options={json.dumps(values)}')


class _Inbox:
    """Requests of the parent, read in a thread so that interrupts work during a run."""

    def __init__(self) -> None:
        self._requests: queue.SimpleQueue[RunRequest | None] = queue.SimpleQueue()
        self._interrupted = False
        self.graph: SampledGraph | None = None

    def listen(self) -> None:
        """Read until the parent closes the pipe."""
        from taxinet_ros.trials.worker_pool import request_from_json

        # Unbuffered: an unjoined thread would hold a buffer's lock forever.
        for line in io.FileIO(sys.stdin.fileno(), closefd=False):
            message = json.loads(line)
            if 'run' in message:
                self._requests.put(request_from_json(message['run']))
            else:
                self._interrupt()
        self._requests.put(None)

    def requests(self) -> Iterator[RunRequest]:
        """Yield the runs as they arrive, until there are no more."""
        while not self._interrupted and (request := self._requests.get()) is not None:
            yield request

    def _interrupt(self) -> None:
        self._interrupted = True
        self._requests.put(None)
        if self.graph is not None:
            self.graph.interrupt()


class _Outbox:
    """Sends whole lines to the parent from several threads."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._lock = threading.Lock()

    def say(self, **message: Any) -> None:
        """Send one line."""
        from taxinet_ros.trials.worker_pool import encode_line

        with self._lock:
            os.write(self._fd, encode_line(message))

    def answer(self, request: RunRequest, result: RunResult) -> bool:
        """Send a result; the parent decides whether to keep this graph."""
        from taxinet_ros.trials.worker_pool import result_to_json

        self.say(result=result_to_json(result))
        return True

    def beat(self, graph: SampledGraph, end: threading.Event) -> None:
        """Report the progress of the run periodically; silence means that it hangs."""
        told = -1
        while not end.wait(_BEAT_S):
            if graph.seq != told:
                told = graph.seq
                self.say(seq=told)


def main(words: Sequence[str] | None = None) -> int:
    """Serve run requests until there are no more.

    Returns:
        Exit code: 0, or 2 after a usage error.
    """
    arguments = _arguments(words)
    from taxinet_ros.core.system import system_values
    from taxinet_ros.nodes.graph.runner import GraphOptions

    values = system_values(json.loads(arguments.options))
    values |= {'out': Path(values['out'])}
    outbox = _Outbox(arguments.answers)
    try:
        _work(GraphOptions(**values), outbox)
    except UsageError as error:
        outbox.say(error=str(error))
        return ExitCode.USAGE
    return ExitCode.OK


def _work(options: GraphOptions, outbox: _Outbox) -> None:
    import cv2

    from taxinet_ros.nodes.graph.runner import composed_graph

    cv2.setNumThreads(1)  # the workers share the cores
    inbox, end = _Inbox(), threading.Event()
    threading.Thread(target=inbox.listen, daemon=True).start()
    with composed_graph(options) as graph:
        inbox.graph = graph
        beat = threading.Thread(target=outbox.beat, args=(graph, end), daemon=True)
        beat.start()
        try:
            graph.run(inbox.requests(), outbox.answer)
        finally:
            end.set()
            beat.join()


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    parser.add_argument('--answers', type=int, required=True)
    parser.add_argument('--options', required=True)
    return parser.parse_args(words)


if __name__ == '__main__':
    sys.exit(main())
