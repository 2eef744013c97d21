"""The pytest plugin: a fixture for tests of a user's own package (``docs/own_nodes.md``).

pytest loads it where this package is installed; so nothing else is imported before a test asks.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from taxinet_ros.api.campaign import Campaign


@pytest.fixture
def taxinet_campaign(tmp_path: Path) -> Callable[..., Campaign]:
    """Run scenes with a node or a function, and fail unless enough of them are satisfied.

    It is called as :func:`taxinet_ros.testing.campaign.run_campaign`.
    """
    from taxinet_ros.testing.campaign import run_campaign

    return functools.partial(run_campaign, folder=tmp_path)
