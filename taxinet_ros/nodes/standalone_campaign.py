"""The sampler as a program: a campaign or a search on a graph that runs already."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from typing import Any

from taxinet_ros.analysis.learned import write_learned
from taxinet_ros.campaign.campaign import Campaign, exit_code
from taxinet_ros.campaign.interrupts import interrupts
from taxinet_ros.campaign.lines import check_lines, heading, row_line, summary
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.search import Search
from taxinet_ros.campaign.search_lines import search_heading, search_summary, space_lines
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.main import complain, run_node
from taxinet_ros.nodes.spinning import spin_until
from taxinet_ros.nodes.standalone_sampler import USAGE, StandaloneSampler, parameter_words

INFRA, INTERRUPTED = 4, 130

_RIVAL = (
    'another sampler drives this graph; end it first (one that was killed is forgotten after some '
    '20 s), or give each graph its own ROS_DOMAIN_ID'
)


def run_standalone() -> None:
    """Sample, run and tabulate as the parameters say, then exit."""
    run_node(StandaloneSampler, _work, usage=USAGE)


def _work(node: StandaloneSampler, executor: Any) -> int:
    # What the table is written with; after Ctrl-C ``ros2 launch`` waits 5 s, and not longer.
    for name in ('pandas', 'pyarrow.parquet'):
        importlib.import_module(name)
    with parameter_words():
        if node.search is not None:
            return _search(node, executor, node.search)
        return _campaign(node, executor)


def _campaign(node: StandaloneSampler, executor: Any) -> int:
    """The scenes that the program draws, as ``taxinet run`` has them."""
    campaign = Campaign(node.campaign, node.participants, _shown(node))
    with interrupts(node.interrupt, node.give_up), campaign:
        checked = [line.plain for line in check_lines(campaign.check)]
        _say(node, [heading(node.campaign), *campaign.notes, *checked])

        def take(request: RunRequest, result: RunResult) -> bool:
            campaign.take(request, result)
            return campaign.unfinished

        answers = _Answers(node, take)
        _drive(node, executor, campaign.requests(), answers)
    if campaign.rows:
        _say(node, summary(campaign.rows, node.campaign).splitlines())
    if answers.trouble:
        return complain(answers.trouble, INFRA)
    if node.interrupted and len(campaign.rows) < node.campaign.runs:
        return INTERRUPTED
    return exit_code(campaign.rows)


def _search(node: StandaloneSampler, executor: Any, options: SearchOptions) -> int:
    """The scenes that a sampler chooses from what it is told, as ``taxinet falsify`` has them."""
    search = Search(options, node.participants, _shown(node))

    def interrupt() -> None:
        search.interrupt()
        node.interrupt()

    def take(request: RunRequest, result: RunResult) -> bool:
        search.take(request, result)
        return True

    resuming = f'-p resume:=true -p out:={options.campaign.out}'
    with interrupts(interrupt, node.give_up), search:
        heading_lines = [search_heading(search.options), *space_lines(search.space), *search.notes]
        warning = [search.warning] if search.warning else []
        _say(node, [*warning, *heading_lines, *(line.plain for line in check_lines(search.check))])
        answers = _Answers(node, take)
        _drive(node, executor, iter(search.next, None), answers)
        learned = write_learned(search)
    if search.rows or search.interrupted:
        _say(node, [*search_summary(search, resuming), *learned])
    if answers.trouble:
        return complain(f'{answers.trouble}; {resuming} continues it', INFRA)
    if search.interrupted and len(search.rows) < options.campaign.runs:
        return INTERRUPTED
    return exit_code(search.rows)


def _drive(
    node: StandaloneSampler, executor: Any, requests: Iterator[RunRequest], answers: _Answers
) -> None:
    """Have the graph run one request after the other."""
    if node.rivals():
        answers.trouble = _RIVAL
        return
    spin_until(executor, node.start(executor, requests, answers))


class _Answers:
    """Takes the answers of the graph, and tells a run that broke from a graph that is not there.

    Attributes:
        trouble: why the graph cannot be used, in a line; '' where it can.
    """

    def __init__(
        self, node: StandaloneSampler, take: Callable[[RunRequest, RunResult], bool]
    ) -> None:
        self.trouble = ''
        self._node = node
        self._take = take
        self._broken: set[int] = set()

    def __call__(self, request: RunRequest, result: RunResult) -> bool:
        """Take one answer; False ends the campaign."""
        infra = result.outcome is Outcome.INFRA_ERROR
        # A run whose second try finds no graph may be what broke it, so that is its result.
        if infra and request.index not in self._broken:
            self.trouble = _trouble(result, self._node)
            if self.trouble:
                return False
            self._broken.add(request.index)
        return self._take(request, result)


def _trouble(result: RunResult, node: StandaloneSampler) -> str:
    if result.kind == 'busy':
        # The simulator may have been found before the sampler that it works for.
        return _RIVAL if node.rivals() else (
            'the simulator is busy with a run of somebody else; wait for its end, or give each '
            'graph its own ROS_DOMAIN_ID'
        )
    if result.kind != 'not_ready':
        return ''
    if result.who == interface.SIMULATOR:
        return f'simulator: {result.detail}; start it, in the same ROS_DOMAIN_ID'
    if absent := node.absent():
        names = ', '.join(absent)
        return f'{names}: not in the graph; start it, or name in participants who takes part'
    return f'{result.who}: {result.detail}; see what they say'


def _shown(node: StandaloneSampler) -> Callable[[RunRow], None]:
    return lambda row: _say(node, [row_line(row).plain])


def _say(node: StandaloneSampler, lines: list[str]) -> None:
    for line in lines:
        node.get_logger().info(line.rstrip())
