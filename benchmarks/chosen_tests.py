"""Run pytest on chosen tests, in the given order, and write down how each ended.

``python -c 'import sys; sys.path.insert(0, FOLDER); import chosen_tests; chosen_tests.main()'
ORDER RESULTS ARGUMENTS...``: ORDER is a JSON list of tests (empty: all), RESULTS gets one JSON
line for each that has ended. It imports nothing of the checkout, which may be another's.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import pytest


class Chosen:
    """Plugin of pytest."""

    def __init__(self, order: list[str], results: Path) -> None:
        self._rank = {test: place for place, test in enumerate(order)}
        self._results = results

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep what is chosen; after fixtures and tests/conftest.py have sorted it their way."""
        if self._rank:
            items[:] = sorted(
                (item for item in items if item.nodeid in self._rank),
                key=lambda item: self._rank[item.nodeid],
            )

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Write down what cannot be collected."""
        if report.failed:
            self._write(report.nodeid, 'failed', 0.0, str(report.longrepr))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write down how a part of a test ended: its setup, its call or its teardown."""
        self._write(report.nodeid, report.outcome, report.duration,
                    str(report.longrepr)[-2000:] if report.failed else '')

    def _write(self, test: str, outcome: str, duration_s: float, why: str) -> None:
        line = {'test': test, 'outcome': outcome, 'duration_s': duration_s, 'end_s': time.time(),
                'why': why}
        with self._results.open('a') as file:
            file.write(json.dumps(line) + '\n')


def main() -> None:
    """Run pytest and exit as it does."""
    order, results, *arguments = sys.argv[1:]
    plugin = Chosen(json.loads(Path(order).read_text()), Path(results))
    sys.exit(pytest.main(arguments, plugins=[plugin]))
