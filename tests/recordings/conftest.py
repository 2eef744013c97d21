"""A function that sees what synthetic recordings show, and a score of one in a line."""

import sys
from pathlib import Path

import pytest
from synthetic import SEE, record

from taxinet_ros.recordings.score import Score, ScoreOptions, score
from taxinet_ros.recordings.truth import TruthSource

# What `ros2 bag record` makes of a run of ours is made beside other tests.
sys.path.append(str(Path(__file__).resolve().parents[1] / 'bag'))


@pytest.fixture
def see(tmp_path) -> str:
    """Path of the file of perceptions."""
    path = tmp_path / 'see.py'
    path.write_text(SEE)
    return str(path)


@pytest.fixture
def scored(tmp_path, see):
    """Score a drive: ``scored(drive, topic='/fix', …, perception='see', storage=…)``.

    Perceptions are functions of the file, or topics.
    """
    def call(drive, *, perception='see', against='', place='kmwh_04', latency='', specs=(),
             image='', camera='', monitor='', dataset=None, **more) -> Score:
        def word(one):
            return one if one[:1] in ('', '/') else f'{see}:{one}'

        source = {one: more.pop(one) for one in list(more)
                  if one in TruthSource.__dataclass_fields__}
        if drive.truth == 'fix':
            source = {'topic': '/fix', 'heading': '/imu', **source}
        bag = record(tmp_path / f'drive{len(list(tmp_path.iterdir()))}', drive, **more)
        return score(ScoreOptions(
            bags=(bag,), source=TruthSource(**source), perception=word(perception),
            against=word(against), place=place, latency=latency, specs=specs, image=image,
            camera=camera, monitor=monitor, dataset=dataset,
        ))

    return call
