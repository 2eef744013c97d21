"""``taxinet explain`` on runs of the real graph, from bag to page."""

import dataclasses
import json

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.bag.rewrite.frames import restore_frames
from taxinet_ros.bag.run import facts
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import WorldDiffers
from taxinet_ros.core.motion.controller import SteeringGains
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest

pytestmark = pytest.mark.ros

SCENE = Scenario(
    clouds='stratus', rain_fraction=0.9, heading_rad=0.4, cross_track_m=2.0, distance_m=900.0,
    duration_s=2.0,
)
SEQS = 21


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Drawing takes by far the longest; here only that it is done matters."""
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)


def recorded(perception, fingerprint):
    request = RunRequest(
        run_id=perception, index=0, program='p', seed=0, scenario=SCENE,
        judging=Judging(specs=('phi_eventually',)),
        participants=('perception', 'steering_controller', 'mtl_monitor', 'recorder'),
    )
    return RecordedRun(request=request, perception=perception, fingerprint=fingerprint, gains={})


@pytest.fixture(scope='module')
def bags(tmp_path_factory):
    """Two seconds in the rain with the old network and with the truth, without frames."""
    from taxinet_ros.nodes.graph.replay import rerun

    out = tmp_path_factory.mktemp('bags')
    fingerprint = make_perception('original').fingerprint
    rerun(
        [
            (recorded('original', fingerprint), 'original', 'steering'),
            (recorded('truth', ''), 'truth', 'steering'),
        ],
        out, images='none',
    )
    return out


@pytest.mark.nightly
def test_given_a_run_with_faults_in_wind_then_it_is_explained_by_runs_without_each(
    taxinet, tmp_path
):
    failing = dataclasses.replace(
        SCENE, lens_drops_fraction=0.3, camera_freeze_s=0.4, wind_speed_mps=4.0,
        fault_onset_s=0.5, duration_s=12.0,
    )
    run = tx.run(failing, perception='original')
    run.save_bag(tmp_path / 'failing', images=False)
    code, out, err = taxinet('explain', tmp_path / 'failing', '--frames', 1, '--out', 'x')
    assert (code, err) == (0, '')
    assert 'All estimates are equal to the recorded ones, bit for bit.' in out
    found = json.loads((tmp_path / 'x' / 'explain.json').read_text())
    assert [rerun['name'] for rerun in found['reruns']] == [
        'recorded', 'camera_freeze_s', 'lens_drops_percent', 'faults', 'wind', 'all',
    ]
    assert found['reruns'][0]['rho'] == run.rho['phi_eventually'].lower
    assert [factor['name'] for factor in found['factors']][:3] == [
        'camera_freeze_s', 'lens_drops_percent', 'faults',
    ]
    assert 'Driven again without the drops on the lens, the run ' in out
    page = (tmp_path / 'x' / 'explain.html').read_text()
    assert 'Driven again without the drops on the lens' in page


@pytest.mark.nightly
def test_given_an_error_that_no_change_removes_then_each_cause_is_named_once(taxinet, tmp_path):
    (tmp_path / 'my.py').write_text('def look(image):\n    return 3.0, 0.0\n')
    scene = dataclasses.replace(SCENE, rain_fraction=0.0, duration_s=1.0)
    run = tx.run(scene, perception=(word := f'{tmp_path}/my.py:look'))
    run.save_bag(tmp_path / 'blind', images=False)
    code, out, err = taxinet(
        'explain', tmp_path / 'blind', '--perception', word, '--frames', 1, '--out', 'x')
    assert (code, err) == (0, '')
    assert 'the crossing runway, the stratus sky, the hour nor all of it together.' in out


def test_given_a_run_without_frames_then_estimates_come_out_as_recorded_and_a_page(
    bags, taxinet, tmp_path
):
    code, out, err = taxinet('explain', bags / 'original', '--frames', 1, '--out', 'x')
    assert (code, err) == (0, '')
    assert 'All estimates are equal to the recorded ones, bit for bit.' in out
    assert out.rstrip().endswith('page: x/explain.html')
    found = json.loads((tmp_path / 'x' / 'explain.json').read_text())
    assert found['recomputed'] == {'cte_m': 0.0, 'he_rad': 0.0, 'equal': True}
    (moment,) = found['moments']
    trace = open_recording(bags / 'original').columns
    assert len(trace['seq']) == SEQS
    gain = SteeringGains().cte_gain_rad_per_m
    misled = trace['est_he_rad'] - trace['he_rad'] + gain * (trace['est_cte_m'] - trace['cte_m'])
    row = int(np.abs(misled).argmax())
    assert moment['seq'] == row
    assert moment['misled_rad'] == pytest.approx(misled[row])
    assert moment['estimate']['cte_m'] == trace['est_cte_m'][row]
    assert moment['truth']['he_rad'] == trace['he_rad'][row]
    assert [factor['name'] for factor in found['factors']] == [
        'shadow', 'crossing', 'rain', 'overcast', 'clear', 'ten', 'easy']
    assert found['reruns'] == []
    # It rains so hard that the network is blind; in fair weather it sees.
    assert found['blamed'] in ('rain', 'overcast', 'clear')
    names = {path.name for path in (tmp_path / 'x').iterdir()}
    decided = [clause['text'] for clause in found['clauses'] if clause['decides']]
    assert decided[-1] == 'abs(cte) <= 1.5'
    assert f'decided by abs(cte) &lt;= 1.5 at {found["witness_s"]:.1f} s' in (
        tmp_path / 'x' / 'explain.html').read_text()
    assert {'explain.html', 'explain.json', 'explain-clauses.png', 'explain-errors.png',
            'explain-factors.png', f'explain-scenes-{row:04d}.png'} <= names


@pytest.mark.nightly
def test_given_another_network_then_it_is_asked_and_the_page_says_who_drove(bags, taxinet):
    code, out, _ = taxinet(
        'explain', bags / 'truth', '--perception', 'original', '--frames', 1, '--out', 'x',
        '--json')
    found = json.loads(out)
    assert code == 0
    assert (found['perception'], found['recorded_perception']) == ('original', 'truth')
    assert 'The run was driven by truth, not by this network.' in found['sentences']
    assert found['recomputed']['equal'] is False
    assert len(found['moments']) == 1


@pytest.mark.nightly
def test_given_a_run_that_cannot_be_driven_again_then_its_frames_are_asked_or_one_line(
    bags, taxinet, monkeypatch, tmp_path
):
    assert list(restore_frames(open_recording(bags / 'original'), tmp_path / 'original'))

    def elsewhere(recording, wanted):
        path = recording.path
        raise WorldDiffers(f'{path}: step 0: x of the aircraft is another', path=path)
        yield

    monkeypatch.setattr(Recording, 'observations', elsewhere)
    code, out, err = taxinet('explain', bags / 'original', '--out', 'x')
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert 'were not recorded and cannot be re-rendered' in err
    assert not (tmp_path / 'x').exists()
    code, out, err = taxinet(
        'explain', tmp_path / 'original', '--frames', 1, '--out', 'y', '--json')
    assert (code, err) == (0, '')
    found = json.loads(out)
    assert found['recomputed']['equal'] is True
    assert (found['factors'], found['blamed'], len(found['moments'])) == ([], None, 1)
    assert 'x of the aircraft is another' in found['sentences'][0]
    assert (tmp_path / 'y' / f'explain-scenes-{found["moments"][0]["seq"]:04d}.png').exists()


@pytest.mark.parametrize(('words', 'complaint'), [
    ((), 'was run with ground truth, not a network; name one with --perception'),
    (('--perception', 'truth'), 'uses no camera image; name a network'),
    (('--perception', 'taxinett'), "perception: 'taxinett' is unknown"),
    (('--perception', 'taxinet', '--frames', '0'), 'frames'),
])
def test_given_what_cannot_be_done_then_one_line(bags, taxinet, words, complaint, tmp_path):
    code, out, err = taxinet('explain', bags / 'truth', *words)
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert complaint in err
    assert not (tmp_path / 'bags').exists()


def test_given_a_full_folder_or_no_bag_then_one_line(bags, taxinet, tmp_path):
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'mine').touch()
    code, _, err = taxinet('explain', bags / 'original', '--out', 'full')
    assert (code, err.count('\n')) == (2, 1)
    assert 'choose a new folder' in err
    code, _, err = taxinet('explain', 'nothing')
    assert (code, err.count('\n')) == (2, 1)


def test_given_a_run_of_another_network_of_that_name_then_it_is_refused(
    bags, taxinet, monkeypatch
):
    was = facts.recorded_run
    monkeypatch.setattr(
        facts, 'recorded_run', lambda bag: dataclasses.replace(was(bag), fingerprint='f' * 64))
    code, _, err = taxinet('explain', bags / 'original')
    assert (code, err.count('\n')) == (2, 1)
    assert 'sha256 ffffffffffff…' in err
    assert 'name the file, or another network, with --perception' in err
