"""A recording is opened once, and tells all of its run; of several runs, each is a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bag_edits import driven_here
from recordings import BEGUN_NS, Logged, heard, record
from whole_runs import RUN_ID, SCENE, SPECS, STEPS, WEIGHTS, write_run

from taxinet_ros.bag.errors import BagEmpty, BagForeign
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.run.judging import BagVerdict
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.bag.storage.reader import McapFile
from taxinet_ros.errors import UsageError

GOLDEN = Path(__file__).parents[3] / 'bags' / 'golden'
GOOD, BAD = GOLDEN / 'taxinet-midday', GOLDEN / 'original-early-light'
@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """The storage files that are opened from then on."""
    files: list[Path] = []
    read = McapFile.records
    monkeypatch.setattr(
        McapFile, 'records', lambda file: (files.append(file.path), read(file))[1])
    return files


@pytest.fixture(scope='module')
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp('run') / 'run').parent


@pytest.fixture(scope='module')
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp('both') / 'all', heard([GOOD, BAD]), namespace='/left')


def essence(recording: Recording) -> tuple[object, ...]:
    run, facts = recording.run, recording.facts
    assert facts is not None
    verdict = recording.judge('always(abs(cte) <= 3)')
    return (
        run, facts.outcome, dict(facts.judged), repr(facts.figures),
        (verdict.verdict, verdict.interval, verdict.decided_s),
    )


def test_given_a_run_when_opened_then_it_tells_what_was_asked_and_what_came_of_it(
    bag: Path,
) -> None:
    recording = open_recording(str(bag))
    assert (recording.run_id, recording.scenario) == (RUN_ID, SCENE)
    assert (recording.run.perception, recording.run.fingerprint) == ('taxinet', WEIGHTS)
    assert recording.run.gains == {'heading_gain': 1.5}
    assert recording.run.timing.words == ''
    assert recording.facts is not None
    assert recording.facts.outcome == 'PASS'
    assert (recording.complete, recording.plain, recording.damage) == (True, True, ())
    assert recording.free_account is None
    assert [run.name for run in recording.runs] == [RUN_ID]


def test_given_a_run_when_traced_then_units_are_told_and_frames_are_those_recorded(
    bag: Path,
) -> None:
    recording = open_recording(bag)
    trace = recording.trace
    assert isinstance(trace, pd.DataFrame)
    assert (len(trace), trace.attrs['units']['cte_m']) == (STEPS, 'm')
    np.testing.assert_array_equal(trace['cte_m'], recording.columns['cte_m'])
    (frame,) = recording.frames(lambda seq: seq == 3)
    assert (frame.seq, frame.stamp_ns, frame.recorded) == (3, 300_000_000, True)
    assert (frame.image.shape, int(frame.image[0, 0, 0])) == ((200, 360, 3), 90)
    samples = recording.samples
    assert [sample['cte'] for sample in samples.samples] == trace['cte_m'].tolist()


def test_given_a_run_when_judged_then_its_own_formula_has_the_recorded_robustness() -> None:
    recording = open_recording(GOOD)
    own = recording.judge('phi_eventually')
    assert (own.verdict, own.same) == (BagVerdict.SATISFIED, True)
    assert own.recorded == own.interval
    assert recording.judge('always(abs(cte) <= 1)').verdict is BagVerdict.VIOLATED
    with pytest.raises(UsageError):
        recording.judge('always(abs(cte <= 1)')


def test_given_all_that_a_run_tells_when_asked_then_the_file_was_read_once(
    opened: list[Path],
) -> None:
    recording = open_recording(GOOD)
    essence(recording)
    assert (len(recording.trace), len(recording.samples.stamps_ns)) == (121, 121)
    assert recording.info.complete
    assert recording.made_on['numpy']
    assert recording.plain
    assert len(opened) == 1


def test_given_several_runs_in_a_namespace_when_opened_then_each_is_as_in_its_own_bag(
    both: Path,
) -> None:
    recording = open_recording(both)
    assert len(recording) == 2
    assert [run.name for run in recording] == [GOOD.name, BAD.name]
    for own in (GOOD, BAD):
        assert essence(recording[own.name]) == essence(open_recording(own))
        pd.testing.assert_frame_equal(recording[own.name].trace, open_recording(own).trace)
    assert [run.run_id for run in recording] == [recording[0].run_id, recording[1].run_id]
    assert len(recording[1].table('taxi_command')) == 121


def test_given_several_runs_when_taken_for_one_then_they_are_named(both: Path) -> None:
    recording = open_recording(both)
    with pytest.raises(BagForeign, match=f'several runs, {GOOD.name} and {BAD.name}'):
        _ = recording.scenario
    with pytest.raises(UsageError, match='holds 2 runs'):
        recording.judge('phi_always')
    with pytest.raises(UsageError, match='no such run'):
        _ = recording['x']
    with pytest.raises(IndexError):
        _ = recording[2]


def test_given_a_run_without_frames_when_asked_then_they_are_rendered_without_another_pass(
    tmp_path: Path, opened: list[Path]
) -> None:
    own = open_recording(driven_here(tmp_path / 'own'))
    opened.clear()
    (frame,) = own.frames(lambda seq: seq == 2)
    assert (frame.recorded, opened) == (False, [])
    assert list(own.frames(render=False)) == []
    logged = [
        Logged(stored.topic, BEGUN_NS + place, stored.cdr)
        for place, stored in enumerate(stored_messages(own.path))
    ]
    named = open_recording(record(tmp_path / 'named', logged, namespace='/left'))
    (same,) = named.frames(lambda seq: seq == 2)
    assert same.image.tobytes() == frame.image.tobytes()


def test_given_a_file_cut_short_when_opened_then_it_tells_what_it_has(
    bag: Path, tmp_path: Path
) -> None:
    file = tmp_path / 'cut.mcap'
    file.write_bytes(next(bag.glob('*.mcap')).read_bytes()[:-20_000])
    recording = open_recording(file)
    assert not recording.complete
    assert recording.damage
    assert recording.scenario == SCENE
    assert recording.facts is not None
    assert set(recording.facts.judged) <= set(SPECS)
    assert recording.judge('always(abs(cte) <= 9)').verdict is BagVerdict.INCOMPLETE


def test_given_no_run_or_no_bag_when_opened_then_one_line_says_so(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match='no such bag'):
        open_recording(tmp_path / 'nowhere')
    kept = heard([GOOD], keep=lambda message: message.topic.name == '/clock')
    recording = open_recording(record(tmp_path / 'other', kept[1:]))
    assert (len(recording), recording.facts) == (0, None)
    with pytest.raises(BagEmpty, match='no message on /scenario'):
        _ = recording.run
