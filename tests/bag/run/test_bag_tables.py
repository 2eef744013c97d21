"""Tables and facts of a run: values, units, and no ROS needed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bag_faults import chunks_of
from bag_samples import ROOT, make, serialise
from whole_runs import (
    PARTICIPANTS,
    RUN_ID,
    SCENE,
    SPECS,
    STEPS,
    TYPES,
    WEIGHTS,
    run_messages,
    write_run,
)

from taxinet_ros.bag import BagTruncated
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.tables import LONGEST_ARRAY, titles
from taxinet_ros.errors import UsageError


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp('run') / 'run').parent


def test_given_a_run_when_made_tables_then_rows_are_messages_and_dots_are_nesting(
    run: Path,
) -> None:
    tables = open_recording(run).tables()
    assert list(tables) == list(TYPES)
    odometry, trace = tables['/ground_truth/odom'], open_recording(run).columns
    assert len(odometry) == STEPS
    np.testing.assert_array_equal(odometry['pose.pose.position.x'], trace['x_m'])
    np.testing.assert_array_equal(odometry['t_s'], np.arange(STEPS) / 10)
    assert odometry['stamp_ns'].dtype == np.int64
    assert {f'pose.covariance.{k}' for k in range(36)} <= set(odometry.columns)
    assert len(tables['/monitor/robustness']) == STEPS * len(SPECS)
    assert list(tables['/monitor/robustness']['spec'][:2]) == list(SPECS)
    assert tables['/monitor/verdict']['specs.1.spec'].tolist() == [SPECS[1]]
    assert tables['/scenario']['participants.3'].tolist() == [PARTICIPANTS[3]]
    frames = tables['/camera/image_raw']
    assert frames['data.length'].tolist() == [200 * 360 * 3] * STEPS
    assert len(frames.columns) < LONGEST_ARRAY


def test_given_definitions_and_standards_then_columns_have_units(run: Path) -> None:
    tables = open_recording(run).tables()
    command = tables['/taxi_command'].attrs['units']
    assert (command['steering_angle'], command['speed'], command['t_s']) == ('rad', 'm/s', 's')
    assert 'run_id' not in command
    odometry = tables['/ground_truth/odom'].attrs['units']
    assert odometry['pose.pose.position.y'] == 'm'
    assert odometry['twist.twist.angular.z'] == 'rad/s'
    assert odometry['header.stamp.nanosec'] == 'ns'
    assert tables['/monitor/verdict'].attrs['units']['specs.1.header.stamp.sec'] == 's'
    assert all(set(table.attrs['units']) <= set(table.columns) for table in tables.values())
    names = titles(tables['/taxi_command'])
    assert names['steering_angle'] == 'steering_angle [rad]'
    assert 't_s' not in names


def test_given_a_trace_when_made_a_table_then_parquet_keeps_its_units(
    run: Path, tmp_path: Path
) -> None:
    table = open_recording(run).trace
    assert len(table) == STEPS
    assert table['cte_m'][0] == pytest.approx(SCENE.cross_track_m)
    table.to_parquet(tmp_path / 't.parquet')
    again = pd.read_parquet(tmp_path / 't.parquet')
    pd.testing.assert_frame_equal(again, table)
    assert again.attrs['units'] == table.attrs['units']
    assert again.attrs['units']['steering_rad'] == 'rad'
    assert titles(again) == {}


def test_given_a_word_for_a_topic_when_read_then_relative_and_absolute_names_do(run: Path) -> None:
    recording = open_recording(run)
    one, other = recording.table('taxi_command'), recording.table('/taxi_command')
    pd.testing.assert_frame_equal(one, other)
    assert list(open_recording(run).tables(['tracking_error'])) == [
        '/ground_truth/tracking_error', '/perception/tracking_error',
    ]
    with pytest.raises(UsageError, match=r"no topic 'taxi'; it has /scenario, "):
        recording.table('taxi')


def test_given_an_unfinished_run_when_made_a_table_then_it_is_said(
    run: Path, tmp_path: Path
) -> None:
    data = next(run.glob('*.mcap')).read_bytes()
    (tmp_path / 'x.mcap').write_bytes(data[:len(data) // 2])
    with pytest.raises(BagTruncated, match=r'at byte \d+: .*intact messages before'):
        _ = open_recording(tmp_path / 'x.mcap').trace


def test_given_a_run_when_its_facts_are_read_then_they_are_what_was_recorded(run: Path) -> None:
    facts = open_recording(run).facts
    assert facts is not None
    assert (facts.run_id, facts.program, facts.seed, facts.index) == (RUN_ID, 'program', 7, 3)
    assert facts.scene == SCENE.to_human()
    assert (facts.outcome, facts.kind, facts.steps) == ('PASS', '', STEPS)
    assert set(facts.judged) == set(SPECS)
    judged = facts.judged['on_runway']
    assert judged.final
    assert judged.interval.lower == judged.interval.upper > 10
    assert facts.nodes['perception'].fingerprint == WEIGHTS
    assert facts.nodes['steering_controller'].implementation == 'heading_gain=1.5'
    assert facts.figures['max_cross_track_error'] == pytest.approx(2.5)
    assert facts.figures['left_runway'] is False


def test_given_a_controller_of_somebody_else_then_the_run_names_it_and_has_no_gains(
    tmp_path: Path
) -> None:
    law, theirs = (
        serialise(make(
            'taxinet_msgs/msg/NodeStatus', run_id=RUN_ID, node='steering_controller',
            implementation=words,
        )) for words in ('heading_gain=1.5', 'my_pid')
    )
    messages = [(topic, t, theirs if cdr == law else cdr) for topic, t, cdr in run_messages()]
    assert sum(cdr == theirs for _, _, cdr in messages) == 1
    told = open_recording(write_run(tmp_path / 'bag', messages)).run
    assert (told.controller, told.gains) == ('my_pid', {})


def test_given_a_run_cut_off_when_its_facts_are_read_then_those_so_far(
    run: Path, tmp_path: Path
) -> None:
    data = next(run.glob('*.mcap')).read_bytes()
    (tmp_path / 'x.mcap').write_bytes(data[:chunks_of(data)[9][1]])
    facts = open_recording(tmp_path / 'x.mcap').facts
    assert facts is not None
    assert (facts.outcome, facts.figures) == ('', {})
    assert 0 < facts.steps < STEPS
    assert not facts.judged['phi_eventually'].final


PROGRAM = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in ('rclpy', 'rosidl_runtime_py') or name.split('.')[0].endswith(
                ('_msgs', '_interfaces')):
            raise ImportError('blocked: ' + name)
sys.meta_path.insert(0, Blocked())
from pathlib import Path
import taxinet_ros.bag
assert 'pandas' not in sys.modules
from taxinet_ros.bag import check_bag, open_recording
run = Path(sys.argv[1])
recording = open_recording(run)
trace = recording.trace
print(len(trace), trace.attrs['units']['cte_m'], len(recording.table('ground_truth/odom')),
      len(check_bag(run).findings))
"""


def test_given_no_ros_when_a_run_is_read_then_there_are_tables_all_the_same(run: Path) -> None:
    done = subprocess.run(
        [sys.executable, '-c', PROGRAM, str(run)], capture_output=True, text=True, check=False,
        env={**os.environ, 'PYTHONPATH': str(ROOT)},
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.split() == [str(STEPS), 'm', str(STEPS), '0']
