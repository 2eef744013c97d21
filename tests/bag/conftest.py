"""A sound file, and a place to put damaged ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from bag_faults import STEPS
from bag_samples import samples, write_bag


@pytest.fixture(scope='session')
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A sound file of a few chunks."""
    return write_bag(tmp_path_factory.mktemp('whole') / 'run', samples(STEPS)).read_bytes()


@pytest.fixture
def damaged(tmp_path: Path) -> Callable[[bytes], Path]:
    """Puts bytes into a file."""
    def put(data: bytes) -> Path:
        path = tmp_path / 'run_0.mcap'
        path.write_bytes(data)
        return path
    return put
