"""What a cluster costs per run, beside the run itself.

``PYTHONPATH=tests:tests/campaign python tests/campaign/cluster/cluster_overhead.py``; minutes.

Runs are of :mod:`toy_worker`, which only waits, so that more workers than cores can be measured:
the time of a run beyond its wait is that of leader, ledger, Dask and pipes together. Scenes are of
the toy program; those of Scenic, and what a real run sends, are measured by themselves.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import falsify_samples as toy
import psutil
from dask_processes import DaskProcesses
from scipy.stats import t as student

from taxinet_ros.campaign import search as search_module
from taxinet_ros.campaign.cluster.pool import ClusterPool, campaign_cluster
from taxinet_ros.campaign.cluster.task import OUT
from taxinet_ros.campaign.loop_run import Loop, campaign_loop
from taxinet_ros.campaign.options import LOOP, make_options
from taxinet_ros.campaign.record.book import run_request
from taxinet_ros.campaign.samplers.registry import make_sampler
from taxinet_ros.campaign.samplers.space import Point, Space
from taxinet_ros.campaign.scenes.source import SceneSource
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.worker_pool import (
    Executor,
    WorkerPool,
    request_to_json,
    result_to_json,
    run_search,
)

TOY = Path(__file__).with_name('toy_worker.py')


class Open(toy.ToySource):
    """The toy program without requirements, so that every point is a run."""

    def scene(self, index: int, point: Point | None = None, attempt: int = 0):
        return super().scene(index, tuple(0.5 * (x or 0) for x in point or (0.5, 0.5)))


def once(pool: Executor, search: Search) -> tuple[float, float]:
    """Wall-clock and processor time of the leader [s]."""
    wall, cpu = time.monotonic(), time.process_time()
    run_search(search, pool)
    return time.monotonic() - wall, time.process_time() - cpu


def words(values: list[float], factor: float = 1e3) -> str:
    """Mean with its 95 % interval [ms]."""
    mean = statistics.mean(values)
    half = student.ppf(0.975, len(values) - 1) * statistics.stdev(values) / math.sqrt(len(values))
    return f'{factor * mean:.1f} ({factor * (mean - half):.1f} to {factor * (mean + half):.1f})'


def measure(workers: int, where: str, arguments: argparse.Namespace, sampler: str) -> str:
    """One line on so many workers of a cluster, or of the local pool if ``where`` is ''."""
    beyond, leader = [], []
    for _ in range(arguments.repeats):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, 'pace').write_text(str(arguments.pace))
            out, runs = Path(folder, 'out'), arguments.each * workers
            chosen = toy.options(
                out, runs=runs, sampler=sampler, cluster=where, lag=2 * workers
            )
            if where:
                with (
                    campaign_cluster(chosen.campaign, where) as cluster,
                    Search(chosen, ('perception',)) as search,
                    ClusterPool(
                        cluster, [sys.executable, str(TOY), OUT, folder], out, runs=runs,
                        in_flight=chosen.in_flight,
                    ) as pool,
                ):
                    assert cluster.threads == workers
                    wall_s, cpu_s = once(pool, search)
            else:
                with Search(chosen, ('perception',)) as search, WorkerPool(
                    [sys.executable, str(TOY), str(out), folder], workers, out / 'logs'
                ) as local:
                    wall_s, cpu_s = once(local, search)
            beyond.append(wall_s * workers / runs - arguments.pace)
            leader.append(cpu_s / runs)
    what = 'cluster' if where else 'local pool'
    return f'| {what}, {sampler} | {workers} | {words(beyond)} | {words(leader)} |'


def of_real_runs() -> list[str]:
    """What a scene and a sampler cost, and what a run sends."""
    with SceneSource('s_falsif', seed=1, overrides={}, laid_over={}) as source:
        space = source.space()
        source.scene(0, space.point([0.5] * len(space)))
        begun = processor_s()
        for index in range(1, 201):
            source.scene(index, space.point([index / 201] * len(space)))
        scene_s = (processor_s() - begun) / 200
        scenario = source.scene(0)
        asked = [asked_words(name, space) for name in ('halton', 'ce', 'active')]
    options = make_options(
        program='s_falsif', runs=1, seed=1, perception='truth', settings=(), specs=(), out=None,
        processes=False, engine=LOOP,
    )
    request = run_request(options, 0, scenario, ('perception',))
    result = Loop(campaign_loop(dataclasses.replace(options, bags=False), '', '')).run(request)
    sent = [len(json.dumps(each)) for each in (request_to_json(request), result_to_json(result))]
    return [
        f'a scene of s_falsif: {1e3 * scene_s:.2f} ms of processor time (mean of 200)', *asked,
        f'a run sends {sent[0]} bytes to the worker and {sent[1]} back',
    ]


def processor_s() -> float:
    """Processor time of this process and its living children [s]."""
    family = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(sum(process.cpu_times()[:2]) for process in family)


def asked_words(name: str, space: Space) -> str:
    """What a sampler costs per run, early and late in a search."""
    sampler, costs = make_sampler(name, space, 1, 1000), []
    for number in range(1000):
        begun = time.process_time()
        index, point = sampler.next()
        sampler.tell(index, (point[0] or 0.5) - 0.2)
        costs.append(time.process_time() - begun)
        assert number == index
    early, late = (1e3 * statistics.mean(part) for part in (costs[50:150], costs[-100:]))
    return f'{name}: {early:.2f} ms of processor time a run near run 100, {late:.2f} near run 950'


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument('--pace', type=float, default=0.3, help='length of a run [s]')
    parser.add_argument('--each', type=int, default=20, help='runs of each worker')
    parser.add_argument('--repeats', type=int, default=5)
    parser.add_argument('--workers', type=int, nargs='*', default=[2, 4, 8, 16])
    arguments = parser.parse_args()
    search_module.SceneSource = Open  # type: ignore[misc, assignment]
    print(f'load before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores')
    print('| what | workers | ms per run beyond its own time | processor ms of the leader |')
    for workers in arguments.workers:
        with tempfile.TemporaryDirectory() as folder, DaskProcesses(Path(folder)) as dask:
            for _ in range(2):
                dask.add_worker(words=('--nthreads', str(workers // 2)))
            for sampler in ('halton', 'ce'):
                print(measure(workers, '', arguments, sampler), flush=True)
                print(measure(workers, dask.address, arguments, sampler), flush=True)
    search_module.SceneSource = SceneSource  # type: ignore[misc]
    print('\n'.join(of_real_runs()), f'load after: {os.getloadavg()[0]:.1f}', sep='\n')


if __name__ == '__main__':
    main()
