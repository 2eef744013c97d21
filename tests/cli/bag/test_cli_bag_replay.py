"""``taxinet bag render``, ``replay``, ``compare``, ``golden`` and ``taxinet run --from``."""

import csv
import os
import shutil
from pathlib import Path

import cv2
import pytest

from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.rewrite.frames import IMAGE
from taxinet_ros.bag.run.recording import open_recording

GOLDEN = Path(__file__).parents[3] / 'bags' / 'golden'
TRUTH = GOLDEN / 'truth-nominal'
EARLY = GOLDEN / 'original-early-light'

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def again(tmp_path_factory):
    """The scene of the golden run on the truth, run again on this machine, 1 s of it."""
    import dataclasses

    from taxinet_ros.nodes.graph.replay import rerun

    run = open_recording(TRUTH).run
    scenario = dataclasses.replace(run.request.scenario, duration_s=1.0)
    request = dataclasses.replace(run.request, run_id='short', scenario=scenario)
    out = tmp_path_factory.mktemp('again')
    again = dataclasses.replace(run, request=request)
    rerun([(again, 'truth', 'steering')], out, images='none')
    return out / 'short'


def test_given_a_bag_without_frames_when_rendered_then_doctor_agrees(again, taxinet, tmp_path):
    code, out, _ = taxinet('bag', 'render', again, '--out', tmp_path / 'new')
    assert (code, out.split(' into ')[0]) == (0, '11 frames rendered')
    assert read_info(again).counts.get(IMAGE) is None
    assert taxinet('doctor', tmp_path / 'new')[0] == 0
    code, out, _ = taxinet('bag', 'render', tmp_path / 'new')
    assert (code, out.split(':')[0]) == (0, 'nothing to do')
    code, _, err = taxinet('bag', 'render', tmp_path / 'new', '--out', 'newer')
    assert code == 2
    assert '--out newer: nothing to render for it: all 11 frames are in' in err
    assert not Path('newer').exists()
    assert taxinet('bag', 'render', again, '--out', tmp_path / 'new')[0] == 2


def test_given_a_recorded_run_when_run_again_then_it_is_the_same_to_the_byte(again, taxinet):
    code, out, _ = taxinet('run', '--from', again, '--out', 'new')
    assert code == 0
    assert 'rerun of short, perception truth -> new' in out
    assert 'the same: ' in out
    code, out, _ = taxinet('bag', 'compare', again, 'new/short')
    assert (code, out.splitlines()[-1]) == (0, 'the files are byte-identical')


def test_given_another_perception_when_run_again_then_the_first_step_is_told(again, taxinet):
    code, out, _ = taxinet(
        'run', '--from', again, '--perception', 'original', '--images', 'none', '--out', 'new'
    )
    assert code == 1
    assert 'perception truth, now original (' in out
    assert '; first at step 0 (0.0 s)' in out
    code, out, _ = taxinet('bag', 'compare', again, 'new/short')
    assert code == 1
    lines = {line.split()[0]: line for line in out.splitlines()}
    assert '11 of 11 differ' in lines['/perception/tracking_error']


def test_given_a_run_when_replayed_into_another_network_then_table_and_picture(again, taxinet):
    words = ('bag', 'replay', again, '--perception', 'taxinet', '--out')
    code, out, _ = taxinet(*words, 'strict')
    assert code == 1
    assert 'short into perception: recorded: truth, now: taxinet (' in out
    assert '0 of 11' in out
    picture = cv2.imread('strict/replay.png')
    assert picture.shape[0] > 500
    assert picture.std() > 10
    with Path('strict/replay.csv').open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row['seq'] for row in rows] == [str(seq) for seq in range(11)]
    assert rows[3]['recorded_cross_track_estimate_m'] == rows[3]['true_cross_track_m']
    limits = ('--tolerance-cte', '5', '--tolerance-he', '30')
    code, out, _ = taxinet(*words, 'wide', *limits)
    assert code == 0
    assert 'the same within the tolerance' in out


@pytest.mark.parametrize('node', ['perception', 'steering_controller', 'mtl_monitor'])
def test_given_the_same_node_when_replayed_into_then_the_same_to_the_bit(node, again, taxinet):
    code, out, _ = taxinet('bag', 'replay', again, '--into', node, '--out', 'new')
    assert code == 0
    assert 'bit-identical' in out
    assert os.path.getsize('new/replay.png') > 10_000


def test_given_a_golden_bag_that_comes_out_otherwise_then_update_records_it_anew(
    again, taxinet, tmp_path
):
    golden = tmp_path / 'golden'
    shutil.copytree(again, golden / 'short')
    assert taxinet('run', '--from', again, '--perception', 'original', '--out', 'new')[0] == 1
    code, out, _ = taxinet('bag', 'golden', golden, '--update')
    assert (code, out.splitlines()[-1]) == (0, '0 of 1 golden bags re-recorded')
    before = {path.name: path.read_bytes() for path in (golden / 'short').iterdir()}
    assert taxinet('bag', 'golden', golden)[0] == 0

    # As if the program had been another one: the recorded run is that of another scene.
    shutil.rmtree(golden / 'short')
    _with_other_commands(again, golden / 'short')
    code, out, _ = taxinet('bag', 'golden', golden)
    assert code == 1
    assert '/taxi_command  1 of 11 differ' in out
    code, out, _ = taxinet('bag', 'golden', golden, '--update')
    assert code == 0
    assert '/taxi_command  1 of 11 differ' in out
    assert out.splitlines()[-1] == '1 of 1 golden bags re-recorded'
    assert {path.name: path.read_bytes() for path in (golden / 'short').iterdir()} == before


def _with_other_commands(source: Path, folder: Path) -> None:
    from taxinet_ros.bag.reader import stored_messages
    from taxinet_ros.bag.writer import BagWriter

    info = read_info(source)
    with BagWriter(
        folder, info.topics, metadata={}, attachments={}, min_free_bytes=0
    ) as bag:
        for topic, stamp_ns, cdr, _ in stored_messages(source):
            if topic.name == '/taxi_command' and stamp_ns == 400_000_000:
                cdr = cdr[:-1] + bytes([cdr[-1] ^ 1])
            bag.write(topic.name, cdr, stamp_ns)
