"""``Run.save_bag``: the bag that the graph records of the same run, made without ROS."""

from __future__ import annotations

import errno
import hashlib
import math
import os
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from bag_edits import altered, unaltered
from own_place import OWN_PLACE

import taxinet_ros as tx
from taxinet_ros.bag.reader import read_info, read_messages
from taxinet_ros.bag.run.messages import message_cdr
from taxinet_ros.core import topics
from taxinet_ros.core.topics import PARTICIPANTS

ROOT = Path(__file__).resolve().parents[2]
SHORT = tx.Scenario(cross_track_m=2.0, duration_s=1.0)
SPECS = ['phi_always', 'always(abs(steering) <= 15 deg)']
WITHOUT_ROS = """
import sys
for name in ('rclpy', 'taxinet_msgs', 'sensor_msgs', 'std_msgs', 'builtin_interfaces', 'nav_msgs'):
    sys.modules[name] = None  # importing it raises ImportError
"""


@pytest.fixture(scope='module')
def run() -> tx.Run:
    return tx.run(SHORT, specs=SPECS)


@pytest.mark.ros
@pytest.mark.parametrize('asked', [
    {'perception': 'taxinet', 'specs': SPECS},
    {'perception': 'truth', 'stop_on': 'violated', 'bounds': ['cte=-25:25'], 'rates': ['cte=3']},
    {'perception': 'truth', 'latency': 'perception=normal(0.15,0.05)',
     'controller': tx.SteeringLaw(tx.SteeringGains(heading_gain=1.0))},
    {'perception': f'{ROOT}/examples/perception_function.py:bright_paint'},
], ids=['network', 'stopped', 'late and tuned', 'file'])
def test_given_a_run_then_its_bag_is_to_the_byte_the_one_that_the_graph_records(asked, tmp_path):
    from taxinet_ros.core.pacing.timing import parse_latency
    from taxinet_ros.core.verdict.outcome import RunRequest
    from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

    here = tx.run(SHORT, **asked)
    bag = here.save_bag(tmp_path / 'loop' / 'run-1')
    request = RunRequest(
        run_id='run-1', index=0, program='', seed=0, scenario=SHORT, judging=here.judging,
        participants=PARTICIPANTS,
    )
    options = GraphOptions(
        perception=asked['perception'], out=tmp_path / 'graph',
        timing=parse_latency([asked.get('latency', '')]),
        gains={'heading_gain': 1.0} if 'controller' in asked else {},
    )
    with composed_graph(options) as graph:
        graph.run([request], lambda request, result: True)
    for file in sorted(bag.iterdir()):
        assert file.read_bytes() == (tmp_path / 'graph' / 'run-1' / file.name).read_bytes()


def test_given_no_ros_then_the_messages_and_types_are_the_same(run, tmp_path):
    done = subprocess.run(
        [sys.executable, '-c', WITHOUT_ROS + f"""
from pathlib import Path
import taxinet_ros as tx
from taxinet_ros.bag import topics
topics._search_path = lambda prefixes: (topics._OURS,)  # nor are its definitions installed
run = tx.run(tx.Scenario(cross_track_m=2.0, duration_s=1.0), specs={SPECS!r})
run.save_bag(Path({str(tmp_path)!r}) / 'alone' / 'run')
"""], capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stderr
    bags = run.save_bag(tmp_path / 'beside' / 'run'), tmp_path / 'alone' / 'run'
    beside, alone = (list(read_messages(bag)) for bag in bags)
    assert beside == alone
    described = [
        {topic.name: (topic.type, topic.type_hash, topic.qos) for topic in read_info(bag).topics}
        for bag in bags
    ]
    assert described[0] == described[1]


def test_given_a_saved_run_when_opened_then_it_is_the_run(run, tmp_path):
    recording = tx.open_recording(run.save_bag(tmp_path / 'a-run'))
    assert recording.scenario == SHORT
    pd.testing.assert_frame_equal(recording.trace, run.trace, check_exact=True)
    assert recording.judge('phi_always').interval == run.rho['phi_always']
    assert [frame.seq for frame in recording.frames(render=False)] == list(range(11))


@pytest.mark.parametrize('command', [
    ['doctor'], ['monitor', '--spec', 'phi_always'], *(
        pytest.param(command, marks=pytest.mark.nightly)
        for command in (['bag', 'info'], ['bag', 'split', '--out', 'parts'])
    ),
])
def test_given_a_saved_run_then_the_commands_read_it(command, run, tmp_path):
    bag = run.save_bag(tmp_path / 'a-run')
    done = subprocess.run(
        [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()', *command, str(bag)],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )
    assert done.returncode == int(command[0] == 'monitor'), done.stderr  # phi_always is violated


def test_given_no_images_then_all_else_is_there(run, tmp_path):
    recording = tx.open_recording(run.save_bag(tmp_path / 'small', images=False))
    assert recording.trace.equals(run.trace)
    assert len(list(recording.frames())) == 11  # rendered anew
    assert len(list(recording.frames(render=False))) == 0


def test_given_what_could_not_be_judged_then_its_bag_says_so(tmp_path):
    run = tx.run(SHORT, perception=lambda frame: None, specs='always(abs(cte_estimate) <= 9)')
    assert run.outcome == 'INFRA_ERROR'
    assert run.detail.endswith('reads cte_estimate, which is nan at 0 s')
    recording = tx.open_recording(run.save_bag(tmp_path / 'broken'))
    assert recording.facts.outcome == 'INFRA_ERROR'
    assert recording.facts.kind == 'invalid_run'


@pytest.mark.parametrize('what', ['folder', 'file', 'dangling link'])
def test_given_something_at_the_path_then_it_is_refused_by_name_and_stays(what, run, tmp_path):
    there = tmp_path / 'there'
    if what == 'folder':
        there.mkdir()
    elif what == 'file':
        there.write_text('mine')
    else:
        there.symlink_to(tmp_path / 'nowhere')
    with pytest.raises(tx.UsageError, match='there: exists already'):
        run.save_bag(there)
    assert [file.name for file in tmp_path.iterdir()] == ['there']


def test_given_a_name_that_no_run_can_have_then_it_is_refused(run, tmp_path):
    with pytest.raises(tx.UsageError, match='use letters, digits'):
        run.save_bag(tmp_path / 'my run')
    assert list(tmp_path.iterdir()) == []


def test_given_a_disk_that_refuses_amid_the_bag_then_nothing_of_it_stays(
    run, tmp_path, monkeypatch
):
    write, written = os.write, []

    def refuse(descriptor, data):
        written.append(len(data))
        if len(written) > 5:
            raise OSError(errno.ENOSPC, 'No space left on device')
        return write(descriptor, data)

    monkeypatch.setattr(os, 'write', refuse)
    with pytest.raises(tx.BagError, match='No space left'):
        run.save_bag(tmp_path / 'full')
    monkeypatch.undo()
    assert len(written) > 5
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_given_a_place_of_ones_own_when_saved_then_the_bag_alone_shows_and_judges_it(tmp_path):
    there = tx.Scenario(place=OWN_PLACE, cross_track_m=20.0, duration_s=1.0)
    bag = tx.run(there, specs=SPECS).save_bag(tmp_path / 'run')
    program = """
import hashlib, sys
import taxinet_ros as tx
recording = tx.open_recording(sys.argv[1])
first = next(iter(recording.frames()))
print(hashlib.sha256(first.image.tobytes()).hexdigest(), recording.scenario.runway.width_m)
print(recording.judge('phi_always').interval.lower)
"""
    told = subprocess.run(
        [sys.executable, '-c', program, str(bag)], capture_output=True, text=True, check=True
    )
    shown, rho = told.stdout.splitlines()
    digest = hashlib.sha256(tx.render(there).tobytes()).hexdigest()
    assert shown == f'{digest} 45.0'
    assert float(rho) < -18


@pytest.mark.parametrize('reaction', [
    pytest.param({}, marks=pytest.mark.nightly),
    pytest.param({'stands_within_m': 23}, marks=pytest.mark.nightly),
    {'starts_within_m': 29, 'stands_within_m': 21},
])
def test_given_others_on_the_ground_when_saved_then_the_bag_alone_shows_and_judges_them(
    reaction, tmp_path
):
    van = {'kind': 'vehicle', 'x_m': 430, 'y_m': -9, 'heading_deg': 90,
           'path': [{'x_m': 430, 'y_m': 9, 'speed_mps': 5}], **reaction}
    scene = tx.Scenario(traffic=tx.load_traffic([van]), duration_s=2.0)
    run = tx.run(scene, specs=[*SPECS, 'no_collision'])
    assert [0 < one.ns < 2e9 for one in run.steps[-1].observation.held.values()] == (
        [True] if reaction else []
    )
    bag = run.save_bag(tmp_path / 'run')
    bare = tx.open_recording(run.save_bag(tmp_path / 'bare', images=False))
    program = """
import hashlib, sys
import taxinet_ros as tx
recording = tx.open_recording(sys.argv[1])
frames = [frame.image.tobytes() for frame in recording.frames()]
print(hashlib.sha256(b''.join(frames)).hexdigest())
print(recording.judge('no_collision').interval.lower, recording.judge('keep_clear').interval.lower)
print(recording.judge('always(collision < 0.5)').interval.lower)
print(hashlib.sha256(recording.trace['clearance_m'].to_numpy().tobytes()).hexdigest())
"""
    told = subprocess.run(
        [sys.executable, '-c', program, str(bag)], capture_output=True, text=True, check=True
    ).stdout.split()
    frames = b''.join(image.tobytes() for image in run.frames())
    assert told[0] == hashlib.sha256(frames).hexdigest()
    assert b''.join(frame.image.tobytes() for frame in bare.frames()) == frames
    closest = run.rho['no_collision'].lower
    assert [float(word) for word in told[1:4]] == [closest, closest - 3, 0.5]
    assert told[4] == hashlib.sha256(run.trace['clearance_m'].to_numpy().tobytes()).hexdigest()
    recording = tx.open_recording(bag)
    assert list(recording.trace.columns) == list(run.trace.columns)
    again = [dict(row) for row in recording.samples.samples]
    assert [row['clearance'] for row in again] == [step.clearance_m for step in run.steps]

    lossy = tx.open_recording(altered(
        bag, tmp_path / 'lossy', unaltered,
        keep=lambda one: one.topic.name != '/ground_truth/odom' or one.stamp_ns != 700_000_000,
    ))
    gaps = [math.isnan(row['clearance']) for row in lossy.samples.samples]
    assert gaps == [step == 7 or (step > 7 and bool(reaction)) for step in range(21)]
    assert math.isnan(lossy.trace['clearance_m'].iloc[-1]) is bool(reaction)
    assert lossy.judge('no_collision').verdict == 'INVALID'


def test_given_messages_of_another_version_then_one_line_says_what_to_do():
    with pytest.raises(tx.UsageError, match=r'Scenario, as it is installed, has no fog: .* anew'):
        message_cdr(topics.SCENARIO, {'fog': 1.0})
