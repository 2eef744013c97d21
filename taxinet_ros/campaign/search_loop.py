"""Keeps every worker of a search busy until it ends."""

from __future__ import annotations

from taxinet_ros.campaign.crew import Crew
from taxinet_ros.campaign.search import Search

_POLL_S = 0.2


def run_search(search: Search, crew: Crew) -> None:
    """Run a search to its end, or until it is interrupted and the runs under way have ended.

    Raises:
        UsageError: program or perception failed in a way that the user has to mend.
    """
    while True:
        if search.interrupted and not crew.interrupted:
            crew.interrupt()
        while crew.free and (request := search.next()) is not None:
            crew.give(request)
        if not crew.busy:
            return
        for request, result in crew.answers(_POLL_S):
            search.take(request, result)
