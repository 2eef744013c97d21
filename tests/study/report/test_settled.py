import shutil
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.study.report.results import settled_cross_track_m

GOLDEN = Path(__file__).resolve().parents[3] / 'bags' / 'golden'


def test_given_bags_then_the_first_ten_seconds_do_not_count(tmp_path):
    names = ['truth-nominal', 'taxinet-midday']
    expected = []
    for name in names:
        table = open_recording(GOLDEN / name).trace
        expected.append(table['cte_m'][table['t_s'] >= 10].abs().median())
    assert settled_cross_track_m(GOLDEN, names) == pytest.approx(expected)
    # It differs from that of the whole run, which starts metres aside.
    whole = open_recording(GOLDEN / names[1]).trace['cte_m'].abs()
    assert whole.median() != pytest.approx(expected[1])


def test_given_a_bag_that_is_gone_or_damaged_then_its_value_is_not_known(tmp_path):
    shutil.copytree(GOLDEN / 'truth-nominal', tmp_path / 'cut')
    (bag,) = (tmp_path / 'cut').glob('*.mcap')
    bag.write_bytes(bag.read_bytes()[:5000])
    assert np.isnan(settled_cross_track_m(tmp_path, ['cut', 'gone'])).all()
