"""Figures and sheet of a perception on labelled frames."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image

from taxinet_ros.analysis.camera.compare import (
    compare_frames,
    comparison_scenes,
    comparison_sheet,
    quantity_errors,
    spread_out,
)
from taxinet_ros.core.perception.labelled_frames import LabelledFrame
from taxinet_ros.core.types import NO_ESTIMATE, TrackingError
from taxinet_ros.errors import UsageError


class Reader:
    """Reads the cross-track error off the red of the first pixel; blind where that is 0."""

    word = 'taxinet'
    fingerprint = 'f' * 64
    needs_image = True

    def estimate(
        self, image: NDArray[np.uint8] | None, truth: TrackingError | None
    ) -> TrackingError:
        assert image is not None
        assert truth is None
        red = float(image[0, 0, 0])
        return TrackingError(cte_m=red / 10, he_rad=0.1) if red else NO_ESTIMATE


def frame(
    folder: Path, cte_m: float, red: int, he_rad: float = 0.1, distance_m: float = 500.0
) -> LabelledFrame:
    name = f'{red}-{cte_m}.png'
    picture = np.zeros((200, 360, 3), np.uint8)
    picture[..., 0] = red
    Image.fromarray(picture).save(folder / name)
    truth = TrackingError(cte_m=cte_m, he_rad=he_rad)
    return LabelledFrame(image=name, path=folder / name, truth=truth, distance_m=distance_m)


def test_given_estimates_when_compared_then_the_figures_are_those_worked_out_by_hand(
    tmp_path: Path,
):
    frames = [frame(tmp_path, *pair) for pair in ((1.0, 20), (2.0, 20), (6.0, 50), (7.0, 0))]
    found = compare_frames(frames, Reader())
    assert found.without_estimate == 1
    errors = found.cte_m
    # Errors +1, 0, -1; the three answered labels have the mean 3.
    assert errors.mae == pytest.approx(2 / 3)
    assert errors.bias == pytest.approx(0, abs=1e-12)
    assert errors.mean_predictor_mae == pytest.approx(2.0)
    assert errors.correlation == pytest.approx(np.corrcoef([1, 2, 6], [2, 2, 5])[0, 1])
    assert found.heading_error_deg.mae == pytest.approx(0, abs=1e-9)
    assert found.heading_error_deg.correlation is None, 'a constant correlates with nothing'


def test_given_a_comparison_when_made_json_then_every_frame_is_there_and_nothing_is_nan(
    tmp_path: Path,
):
    frames = [frame(tmp_path, 1.0, 20), frame(tmp_path, 7.0, 0)]
    values = json.loads(json.dumps(compare_frames(frames, Reader()).to_dict(), allow_nan=False))
    assert (values['frame_count'], values['without_estimate']) == (2, 1)
    assert values['cte_mae_m'] == pytest.approx(1.0)
    assert values['cte_mae_m_95'] == pytest.approx([1.0, 1.0])
    assert values['mean_predictor_cte_mae_m'] == 0
    assert values['heading_error_correlation'] is None
    seen, blind = values['frames']
    assert seen['image'] == '20-1.0.png'
    assert seen['heading_error_deg'] == pytest.approx(np.degrees(0.1))
    assert seen['cte_error_m'] == pytest.approx(1.0)
    assert (blind['cte_m'], blind['cte_estimate_m'], blind['cte_error_m']) == (7.0, None, None)


def test_given_no_estimate_at_all_when_compared_then_there_are_no_figures(tmp_path: Path):
    found = compare_frames([frame(tmp_path, 1.0, 0)], Reader())
    assert found.without_estimate == 1
    assert (found.cte_m.mae, found.cte_m.mae_95, found.cte_m.mean_predictor_mae) == (None,) * 3


@settings(max_examples=20)
@example([(0.0, 0.0), (1.0, 1e-305)])
@given(st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=30))
def test_given_any_numbers_when_measured_then_the_interval_holds_the_mean_and_seeds_repeat(
    pairs: list[tuple[float, float]],
):
    labels, estimates = np.array(pairs).T
    found = quantity_errors(labels, estimates, seed=3)
    assert found == quantity_errors(labels, estimates, seed=3)
    assert found.mae is not None
    assert found.mae_95 is not None
    assert found.bias is not None
    largest = np.abs(estimates - labels).max()
    assert 0 <= found.mae_95[0] <= found.mae_95[1] <= largest + 1e-9
    assert abs(found.bias) <= found.mae + 1e-12


def test_given_normal_errors_when_measured_then_the_interval_is_as_wide_as_theory_has_it():
    errors = np.abs(np.random.default_rng(5).normal(size=400))
    found = quantity_errors(np.zeros(400), errors)
    assert found.mae_95 is not None
    low, high = found.mae_95
    assert low < errors.mean() < high
    assert high - low == pytest.approx(2 * 1.96 * errors.std() / 20, rel=0.1)


def test_given_a_drive_when_frames_are_chosen_then_its_extremes_are_among_them(tmp_path: Path):
    picture = frame(tmp_path, 0.0, 9).path
    frames = [
        LabelledFrame(
            image=str(k), path=picture, distance_m=50.0 + k,
            truth=TrackingError(cte_m=8.0 if k == 17 else 0.01 * k, he_rad=0.5 * (k == 30)),
        )
        for k in range(40)
    ]
    chosen = [int(frame.image) for frame in spread_out(frames, 6)]
    assert len(chosen) == 6
    assert chosen == sorted(chosen)
    assert {0, 17, 30, 39} <= set(chosen)
    assert spread_out(frames[:3], 6) == frames[:3]


def test_given_an_offset_when_scenes_are_made_then_they_have_the_labels_pose_and_the_light(
    tmp_path: Path,
):
    label = frame(tmp_path, -3.0, 9, he_rad=0.2, distance_m=-20.0)
    off = frame(tmp_path, 40.0, 8)
    ((chosen, scene),) = comparison_scenes([label, off], {'clouds': 'broken'}, 29.0)
    assert chosen == label
    assert (scene.cross_track_m, scene.distance_m) == (-3.0, 9.0)
    assert scene.heading_rad == pytest.approx(0.2)
    assert (scene.clouds, scene.time_of_day_s) == ('broken', pytest.approx(9 * 3600 + 240))


def test_given_no_frame_on_our_runway_when_scenes_are_made_then_one_line_says_why(tmp_path: Path):
    with pytest.raises(UsageError, match=r'40, outside -15\.\.15.*--distance-offset'):
        comparison_scenes([frame(tmp_path, 40.0, 8)], {}, 0.0)


def test_given_pairs_when_drawn_then_theirs_are_on_the_sheet_unchanged(tmp_path: Path):
    scenes = comparison_scenes([frame(tmp_path, 1.0, 20), frame(tmp_path, 2.0, 30)], {}, 0.0)
    comparison_sheet(scenes, Reader(), tmp_path / 'sheet.png')
    sheet = np.asarray(Image.open(tmp_path / 'sheet.png'))
    assert sheet.shape[1] > 4 * 360
    for red in (20, 30):
        assert (sheet == (red, 0, 0)).all(axis=2).sum() == 200 * 360
