"""Worker process of a search: one composed graph for many runs.

Started by :class:`taxinet_ros.trials.worker_pool.WorkerProcess`; Linux kills it when its parent
dies.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from taxinet_ros.processes.child import module_command

if TYPE_CHECKING:
    from taxinet_ros.core.system import System
    from taxinet_ros.nodes.graph.runner import GraphOptions, SampledGraph
    from taxinet_ros.trials.options import CampaignOptions
    from taxinet_ros.trials.worker_pool import Link


def campaign_worker_command(campaign: CampaignOptions, facts: Mapping[str, Any]) -> list[str]:
    """Command line of a worker for the runs of a campaign, by its engine."""
    from taxinet_ros.trials.loop_worker import loop_worker_command
    from taxinet_ros.trials.options import GRAPH
    from taxinet_ros.trials.record.facts import recorded_system

    system = recorded_system(campaign, facts)
    if campaign.engine == GRAPH:
        from taxinet_ros.nodes.graph.runner import campaign_graph

        return worker_command(campaign_graph(campaign, system))
    return loop_worker_command(
        system, campaign.bag_folder, campaign.images, audit_percent=campaign.audit_percent,
        audit_command=audit_command(campaign, system) if campaign.runs_graphs else (),
    )


def audit_command(campaign: CampaignOptions, system: System) -> list[str]:
    """Command line of a worker that repeats runs of a campaign for :class:`.Auditor`."""
    from taxinet_ros.nodes.graph.runner import campaign_graph
    from taxinet_ros.trials.options import AUDIT_FOLDER

    graph = campaign_graph(campaign, system)
    return worker_command(dataclasses.replace(graph, out=campaign.out / AUDIT_FOLDER))


def worker_command(options: GraphOptions) -> list[str]:
    """Command line of a worker with a graph, in a folder that exists."""
    values = {**dataclasses.asdict(options), 'out': str(options.out), 'make_out': False}
    return module_command('taxinet_ros.nodes.graph.worker', f'--options={json.dumps(values)}')


def _work(values: dict[str, Any], link: Link) -> None:
    import cv2

    from taxinet_ros.files.plain_values import typed
    from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

    cv2.setNumThreads(1)  # the workers share the cores
    options = typed(GraphOptions, values)
    end = threading.Event()
    with composed_graph(options) as graph:
        link.interrupt = graph.interrupt
        beat = threading.Thread(target=_report, args=(graph, link, end), daemon=True)
        beat.start()
        try:
            graph.run(link.requests(), link.answer)
        finally:
            end.set()
            beat.join()


def _report(graph: SampledGraph, link: Link, end: threading.Event) -> None:
    """Report the progress of the run periodically; silence means that it hangs."""
    from taxinet_ros.trials.worker_pool import BEAT_S

    while not end.wait(BEAT_S):
        link.progress(graph.seq)


if __name__ == '__main__':
    from taxinet_ros.trials.worker_pool import serve

    sys.exit(serve(_work))
