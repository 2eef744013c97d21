"""Programs written down, and a Scenic child that reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from scenic_client import scenic_child

from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.parameters import checked_overrides, checked_parameters


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
    """Compile a program, and check its parameters as a command does; the answer or the error."""
    def compile_text(text: str) -> dict[str, Any]:
        path = write(text)
        said: dict[str, Any] = client.ask(op='compile', program=str(path))
        try:
            if 'error' not in said:
                checked_overrides(path, said['overrides'])
                checked_parameters(path, said['params'], said['objects'], said['random_objects'])
        except UsageError as error:
            file, line, message = str(error).split(':', 2)
            said = {'error': {'file': file, 'line': int(line), 'message': message.lstrip()}}
        return said

    return compile_text


@pytest.fixture
def refused(compiled: Any, tmp_path: Path) -> Callable[[str, int, str], None]:
    """Assert that a program is refused as it is compiled: at which line, and how it begins."""
    def check(text: str, line: int, message: str) -> None:
        error = compiled(text)['error']
        assert (error['file'], error['line']) == (str(tmp_path / 'mine.scenic'), line)
        assert error['message'].startswith(message)
        assert '\n' not in error['message']

    return check
