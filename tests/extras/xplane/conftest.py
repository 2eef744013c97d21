"""A fake X-Plane for each test."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fake_xplane import FakeXPlane


@pytest.fixture
def sim() -> Iterator[FakeXPlane]:
    with FakeXPlane() as fake:
        yield fake
