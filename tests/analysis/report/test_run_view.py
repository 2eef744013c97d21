"""A recorded run as the page's viewer shows it."""

import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from report_examples import GOLDEN, NEEDS_OUR_STACK

import taxinet_ros as tx
from taxinet_ros.analysis.report.values import data_block
from taxinet_ros.analysis.report.viewer import (
    MOST_FRAMES,
    RunView,
    ground_shapes,
    read_frames,
    read_run_view,
)
from taxinet_ros.analysis.report.worst import view_worst
from taxinet_ros.bag.errors import BagForeign
from taxinet_ros.bag.rewrite.frames import restore_frames
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.run.resimulation import WorldDiffers
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.errors import UsageError

BAG = GOLDEN / 'truth-nominal'


@pytest.fixture(scope='module')
def view() -> RunView:
    return read_run_view('a run', BAG)


def test_given_a_bag_when_viewed_then_every_curve_has_a_value_for_each_step(view: RunView) -> None:
    data = json.loads(data_block(view.data()))
    trace = open_recording(BAG).columns
    steps = len(trace['seq'])
    curves = ('t', 'x', 'y', 'speed', 'cte', 'cteEstimate', 'he', 'heEstimate', 'steering')
    assert steps > 100
    assert [len(data[name]) for name in curves] == [steps] * len(curves)
    assert data['t'][10] == 1
    assert data['he'][10] == pytest.approx(math.degrees(trace['he_rad'][10]), abs=6e-4)
    assert data['cte'][10] == pytest.approx(trace['cte_m'][10], abs=6e-4)
    assert data['id'] == 'a run'


def test_given_a_judged_run_when_viewed_then_it_has_the_interval_of_each_formula(
    view: RunView,
) -> None:
    formulas = {one['name']: one for one in view.data()['formulas']}
    assert 'phi_eventually' in formulas
    assert formulas['phi_eventually']['lower'][0] == '-∞'
    assert formulas['phi_eventually']['lower'][-1] == formulas['phi_eventually']['upper'][-1]


def test_given_a_bag_when_viewed_then_its_facts_are_in_words(view: RunView) -> None:
    assert view.outcome == 'PASS'
    assert view.facts['perception'] == 'truth'
    assert view.facts['cross track'].endswith(' m')
    assert view.facts['heading'].endswith('°')
    assert view.summary.startswith('cross track ')


@pytest.fixture(scope='module')
def crossed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run whose nose crosses a hold line after a second, which is cleared half a second later."""
    line = {'kind': 'hold_line', 'x_m': 408, 'y_m': 0, 'until_s': 1.5}
    scene = tx.Scenario(duration_s=2.0, distance_m=400.0, traffic=tx.load_traffic([line]))
    bag = tmp_path_factory.mktemp('crossed') / 'run'
    tx.run(scene, perception='truth', specs=['hold_short']).save_bag(bag)
    return bag


def test_given_a_formula_about_a_hold_line_when_viewed_then_its_signal_line_and_moment_are_there(
    crossed: Path,
) -> None:
    view = read_run_view('a run', crossed)
    data = json.loads(data_block(view.data()))
    signal, = data['signals']
    assert (signal['name'], signal['unit']) == ('hold_distance', 'm')
    known = [value for value in signal['values'] if value is not None]
    assert known == signal['values'][:15], 'then it is cleared'
    assert known[0] > 0 > known[-1]
    line, = data['holdLines']
    assert line['until'] == 1.5
    assert np.mean(line['corners'], axis=0) == pytest.approx((408, 0))
    deciding = view.deciding
    assert deciding is not None
    assert (deciding.row, deciding.signal, deciding.bound) == (14, 'hold_distance', 0.0)
    words = view_worst(view, known[-1])['caption']
    assert f'hold_short is decided at 1.4 s, where hold_distance is −{-known[-1]:.2f} m.' in words


def test_given_a_formula_about_pose_when_viewed_then_no_further_signal_decides(
    view: RunView,
) -> None:
    assert (view.signals, view.hold_lines, view.deciding) == ({}, (), None)


@NEEDS_OUR_STACK
def test_given_a_bag_without_frames_when_viewed_then_every_fifth_is_rendered(view: RunView) -> None:
    frames = view.frames
    assert frames.missing == ''
    assert frames.steps == tuple(range(0, len(view.t_s), 5))
    (wanted,) = (frame.image for frame in open_recording(BAG).frames(lambda seq: seq == 10))
    with Image.open(io.BytesIO(frames.files[2])) as image:
        shown = np.asarray(image.convert('RGB')).astype(float)
    assert shown.shape == wanted.shape
    assert np.abs(shown - wanted).mean() < 4


@NEEDS_OUR_STACK
def test_given_a_bag_with_frames_when_viewed_then_those_are_taken(
    tmp_path: Path, view: RunView, monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = tmp_path / 'run'
    assert sum(1 for _ in restore_frames(open_recording(BAG), folder)) == len(view.t_s)
    monkeypatch.setattr(Recording, 'observations', None)
    assert read_frames(open_recording(folder)) == view.frames


def test_given_a_world_that_differs_when_viewed_then_the_rest_is_there_and_it_says_why(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def differing(*_: object) -> object:
        raise WorldDiffers('recorded by another version')

    monkeypatch.setattr(Recording, 'observations', differing)
    view = read_run_view('a run', BAG)
    assert view.frames.steps == ()
    assert view.frames.missing == 'recorded by another version'
    assert len(view.t_s) > 100


def test_given_a_long_run_when_thinned_then_the_number_of_frames_is_bounded(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[bool] = []

    def watched(_: object, wanted: object) -> list[object]:
        # The stand-in takes anything; here it is the predicate on steps.
        asked.extend(wanted(seq) for seq in range(2000))  # type: ignore[operator]
        return []

    monkeypatch.setattr(Recording, 'observations', watched)
    recording = open_recording(BAG)
    vars(recording)['columns'] = {'t_ns': np.arange(2000) * 100_000_000}
    read_frames(recording)
    assert MOST_FRAMES / 2 < sum(asked) <= MOST_FRAMES


def test_given_no_bag_or_a_foreign_one_when_viewed_then_it_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='no such bag'):
        read_run_view('gone', tmp_path / 'gone')
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'run_0.mcap').write_bytes(b'no bag at all, and long enough to be looked at')
    with pytest.raises(BagForeign):
        read_run_view('run', tmp_path / 'run')


def test_given_ground_without_a_crossing_when_drawn_then_the_paint_is_not_interrupted() -> None:
    crossed, plain = (
        ground_shapes(default_runway(), crossing=crossing) for crossing in (True, False)
    )
    assert (len(crossed['pavement']), len(plain['pavement'])) == (2, 1)
    longest = [max(max(x for x, _ in p) - min(x for x, _ in p) for p in ground['paint'])
               for ground in (crossed, plain)]
    assert longest[0] < longest[1] == pytest.approx(plain['length'])


@pytest.mark.nightly
def test_given_a_run_on_a_track_when_viewed_then_the_track_is_drawn_and_the_nose_turns_with_it(
    tmp_path: Path,
) -> None:
    scene = tx.Scenario(track='exit_left', distance_m=310.0, duration_s=4.0)
    run = tx.run(scene, perception='truth', specs='phi_always')
    view = read_run_view('a run', run.save_bag(tmp_path / 'run'))
    data = json.loads(data_block(view.data()))
    assert data['ground'] == 'exit_left crossed'
    yaw_deg = math.degrees(run.steps[0].observation.state.yaw_rad)
    assert data['yaw'][0] == pytest.approx(yaw_deg, abs=0.01)
    assert data['he'][0] == pytest.approx(0, abs=0.01)
    drawn = view.ground_shapes()['track']
    xs, ys = zip(*drawn['pavement'], strict=True)
    assert (max(xs), max(ys)) == pytest.approx((911.43, 500), abs=0.1)
    assert len(drawn['lines']) == 1
