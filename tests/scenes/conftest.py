"""Programs written down, and a Scenic child that reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from scenic_client import scenic_child


@pytest.fixture(scope='module')
def client() -> Iterator[Any]:
    """One child for a module: importing Scenic takes a second."""
    with scenic_child() as started:
        yield started


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write a program down; its path."""
    path = tmp_path / 'mine.scenic'
    return lambda text: (path.write_text(text), path)[1]


@pytest.fixture
def compiled(client: Any, write: Any) -> Callable[[str], dict[str, Any]]:
    """Compile a program; the answer."""
    return lambda text: client.ask(op='compile', program=str(write(text)))


@pytest.fixture
def refused(compiled: Any, tmp_path: Path) -> Callable[[str, int, str], None]:
    """Assert that a program is refused as it is compiled: at which line, and how it begins."""
    def check(text: str, line: int, message: str) -> None:
        error = compiled(text)['error']
        assert (error['file'], error['line']) == (str(tmp_path / 'mine.scenic'), line)
        assert error['message'].startswith(message)
        assert '\n' not in error['message']

    return check
