"""Pictures of others played as frames of ours, by the clock."""

import sys
from pathlib import Path

import numpy as np
import pytest
from synthetic import Drive, path, pixels_of, record

sys.path.append(str(Path(__file__).resolve().parents[1] / 'nodes'))
from graph_runs import spin
from playing import listening, make_player, playing

from taxinet_ros.bag.cdr.image import frame_of_cdr
from taxinet_ros.core.perception.network import usual_frame
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('encoding', ['bgr8', 'png'])
def test_given_pictures_of_any_type_then_they_are_played_as_frames_of_ours(tmp_path, encoding):
    bag = record(tmp_path / 'drive', Drive(seconds=1, encoding=encoding))
    image = interface.IMAGE
    with (
        listening(image) as (listener, executor, context),
        playing(context, executor, bag, rate=5.0, picture='cam', wait_for=['/cam']) as player,
    ):
        assert player.play(executor) == 0
        spin(executor, lambda: len(listener.heard[image.name]) == 11)
        with pytest.raises(UsageError, match='picture: /fix is a sensor_msgs/msg/NavSatFix'):
            make_player(context, bag, picture='/fix')
    for number, cdr in enumerate(listener.heard[image.name]):
        stamp_ns, pixels = frame_of_cdr(bytes(cdr))
        assert stamp_ns % 100_000_000 == 0
        shown = usual_frame(pixels_of(*path(number / 10)[1:], (8, 12)))
        assert np.array_equal(pixels, shown)
