"""What grows is told from what only warms up; a short soak reports and leaves nothing behind."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import pytest
import soak
from soak import FLAT, GROWS, UNSETTLED, trend

pytestmark = pytest.mark.nightly


def test_given_a_quantity_when_it_grows_only_while_warming_up_then_it_is_flat() -> None:
    at = list(range(100))
    warming = [min(step, 15) * 1e6 for step in at]
    leaking = [step * 2000.0 for step in at]
    assert trend(at, warming, per_unit=1024, once=0.0).verdict == FLAT
    found = trend(at, leaking, per_unit=1024, once=0.0)
    assert (found.verdict, found.slope) == (GROWS, pytest.approx(2000.0))
    assert trend(at, leaking, per_unit=1024, once=1e6).verdict == FLAT
    assert trend(at[:10], leaking[:10], per_unit=1024, once=0.0).verdict == UNSETTLED


@pytest.mark.ros
def test_given_a_few_runs_when_soaked_then_a_report_of_them_and_nothing_left(
    capfd, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    assert soak.main(['--runs', '7', '--duration', '0.5', '--json']) == 0
    report = json.loads(capfd.readouterr().out)
    assert report['amount'] == 7
    assert sum(report['outcomes'].values()) == 7
    assert report['samples'] == 2
    assert set(report['trends']) == {*soak.QUANTITIES, soak.OBJECTS}
    assert report['trends']['memory']['first'] > 50e6
    assert report['trends']['segments']['first'] > 0
    assert report['verdict'] == UNSETTLED
    assert list(tmp_path.iterdir()) == []
