"""Recorded runs once more: the same scenarios through the whole graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from taxinet_ros.bag.recorded_run import RecordedRun, words_of_gains
from taxinet_ros.core.controller import STEERING
from taxinet_ros.core.outcome import RunRequest, RunResult
from taxinet_ros.nodes.graph import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.processes import process_graph


def rerun(
    runs: Sequence[tuple[RecordedRun, str, str]], out: Path, *, images: str, processes: bool = False
) -> dict[str, RunResult]:
    """Run recorded runs again, each in a graph as it had one.

    Args:
        runs: each with the words of the perception and the controller to use.
        out: folder that takes the new bags, one folder per run, by the same names.
        images: as in :class:`.graph.GraphOptions`.
        processes: every node a process of its own.

    Returns:
        Results by name of the run.
    """
    results: dict[str, RunResult] = {}

    def keep(request: RunRequest, result: RunResult) -> bool:
        results[request.run_id] = result
        return result.outcome.judged

    def kind(run: tuple[RecordedRun, str, str]) -> tuple[str, str, str, str]:
        return run[1], run[2], words_of_gains(run[0].gains), run[0].timing.words

    for (perception, controller, *_), group in groupby(sorted(runs, key=kind), kind):
        alike = [run for run, *_ in group]
        options = GraphOptions(
            perception=perception, out=out, images=images, controller=controller,
            gains=alike[0].gains if controller == STEERING else {}, timing=alike[0].timing,
        )
        requests = [
            dataclasses.replace(run.request, participants=PARTICIPANTS) for run in alike
        ]
        opened = process_graph(options, out / 'logs') if processes else composed_graph(options)
        with opened as graph:
            graph.run(requests, keep)
    return results
