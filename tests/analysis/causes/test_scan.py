"""What regions are compared by."""

from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.analysis.causes.scan import size_penalty


def test_given_a_region_when_its_size_is_weighed_then_it_counts_as_its_complement_does() -> None:
    inside = np.array([0, 1, 10, 50])
    penalty = size_penalty(inside, 100)
    assert penalty == pytest.approx(size_penalty(100 - inside, 100))
    assert penalty[0] == penalty[1] == pytest.approx(np.sqrt(2 * np.log(100 * np.e)))
    assert penalty[1] > penalty[2] > penalty[3]
