"""The doctor: a whole run passes every check, and each thing that can be wrong is found."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from bag_faults import chunks_of
from bag_samples import Sample, serialise, store
from whole_runs import PER_STEP, SPECS, STEPS, TYPES, run_messages, run_topics, write_run

from taxinet_ros.bag.check.doctor import Checkup, check_bag
from taxinet_ros.bag.check.findings import ranges
from taxinet_ros.bag.check.lockstep import RunRecord
from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.storage.records import MAGIC
from taxinet_ros.bag.writer import BagWriter

CHECKS = ('bytes', 'description', 'types', 'stamps', 'steps', 'verdict')
STEP_NS = 100_000_000


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp('run') / 'run')


def wrong(checkup: Checkup) -> dict[str, list[str]]:
    """Findings by check, as text."""
    return {
        check.name: [f'{found.where}: {found.what}' for found in check.findings]
        for check in checkup.checks if check.findings
    }


def rewritten(tmp_path: Path, change: Callable[[list[Sample]], list[Sample]]) -> Checkup:
    """The checkup of a run with other messages."""
    return check_bag(write_run(tmp_path / 'run', change(list(run_messages()))).parent)


def test_given_a_whole_run_when_checked_then_nothing_is_wrong(run: Path) -> None:
    checkup = check_bag(run.parent)
    assert tuple(check.name for check in checkup.checks) == CHECKS
    assert wrong(checkup) == {}
    assert not any(check.skipped for check in checkup.checks)
    assert len(run_messages()) == 1 + 4 + PER_STEP * STEPS - STEPS + 2


@pytest.mark.parametrize('topic', [topic.name for topic in run_topics()])
def test_a_stamp_before_the_run_begins_is_a_finding(topic: str) -> None:
    name, _, cdr = next(one for one in run_messages() if one[0] == topic)
    info = next(one for one in run_topics() if one.name == topic)
    record = RunRecord()
    record.note(StoredMessage(info, -5 * 10**9, cdr, 0))
    assert record.stamps[0].where == f'{name} at -5.000 s'
    assert record.stamps[0].what == 'stamp goes back from 0 ns'


def test_given_one_file_of_a_run_when_checked_then_only_the_description_is_skipped(
    run: Path,
) -> None:
    checkup = check_bag(run)
    assert wrong(checkup) == {}
    assert [check.name for check in checkup.checks if check.skipped] == ['description']


def test_given_a_flipped_byte_when_checked_then_its_place_and_what_mends_it_are_told(
    run: Path, tmp_path: Path
) -> None:
    data = bytearray(run.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / 'x.mcap').write_bytes(data)
    checkup = check_bag(tmp_path / 'x.mcap')
    found = checkup.checks[0].findings
    assert len(found) == 1
    assert found[0].where.startswith('x.mcap, byte ')
    assert found[0].mend == 'taxinet bag recover {bag} --out NEW'
    assert {check.name for check in checkup.checks if check.skipped} == {'description'}


@pytest.mark.parametrize(('name', 'steps', 'expected'), [
    ('/taxi_command', {4}, 'step 4: without /taxi_command'),
    ('/camera/image_raw', {3, 5, 6}, 'step 3, 5-6: without /camera/image_raw'),
])
def test_given_missing_messages_when_checked_then_their_steps_are_named(
    tmp_path: Path, name: str, steps: set[int], expected: str
) -> None:
    gone = {(name, step * STEP_NS) for step in steps}
    found = wrong(rewritten(tmp_path, lambda all_: [m for m in all_ if m[:2] not in gone]))
    assert found['steps'] == [expected]
    assert ('verdict' in found) == (name == '/taxi_command')


def test_given_a_message_twice_when_checked_then_it_is_named(tmp_path: Path) -> None:
    def twice(messages: list[Sample]) -> list[Sample]:
        place = next(k for k, m in enumerate(messages) if m[:2] == ('/clock', 2 * STEP_NS))
        return [*messages[:place], messages[place], *messages[place:]]

    assert wrong(rewritten(tmp_path, twice)) == {'steps': ['step 2: /clock more than 1 x']}


def test_given_another_truth_when_checked_then_the_verdict_does_not_follow(tmp_path: Path) -> None:
    def shifted(messages: list[Sample]) -> list[Sample]:
        place = next(
            k for k, m in enumerate(messages)
            if m[:2] == ('/ground_truth/tracking_error', (STEPS - 1) * STEP_NS)
        )
        name, stamp, cdr = messages[place]
        truth = next(m for m in messages if m[0] == '/ground_truth/tracking_error')[2]
        number = struct.pack('<d', 9.5)
        other = cdr[:-24] + number + cdr[-16:]
        assert len(other) == len(cdr) == len(truth)
        return [*messages[:place], (name, stamp, other), *messages[place + 1:]]

    found = wrong(rewritten(tmp_path, shifted))
    assert set(found) == {'verdict'}
    assert any(text.startswith(f'step {STEPS - 1}: phi_eventually') for text in found['verdict'])
    assert any('monitor/verdict' in text for text in found['verdict'])


@pytest.mark.parametrize(('name', 'other'), [
    ('left_runway', True), ('max_cross_track_error', 99.0), ('satisfied', False),
])
def test_given_a_verdict_with_another_figure_when_checked_then_it_is_named(
    tmp_path: Path, name: str, other: object
) -> None:
    def forged(messages: list[Sample]) -> list[Sample]:
        return [_with_verdict(sample, **{name: other}) for sample in messages]

    found = wrong(rewritten(tmp_path, forged))
    assert set(found) == {'verdict'}
    (text,) = found['verdict']
    assert text.startswith(f'monitor/verdict: {name}: recorded {other!r}, from the messages ')


@pytest.mark.parametrize(('name', 'other'), [
    ('verdict', 2), ('final', False), ('formula', 'always(abs(cte) <= 2)'),
])
def test_given_a_verdict_with_another_reading_when_checked_then_its_field_is_named(
    tmp_path: Path, name: str, other: object
) -> None:
    def forged(messages: list[Sample]) -> list[Sample]:
        return [_with_verdict(sample, reading={name: other}) for sample in messages]

    (text,) = wrong(rewritten(tmp_path, forged))['verdict']
    assert text.startswith(f'monitor/verdict: phi_eventually: {name}: recorded {other!r}, from')


@pytest.mark.parametrize('kept', [0, 1])
def test_given_a_verdict_without_a_formula_when_checked_then_it_is_named(
    tmp_path: Path, kept: int
) -> None:
    def forged(messages: list[Sample]) -> list[Sample]:
        return [_with_verdict(sample, kept=kept) for sample in messages]

    found = wrong(rewritten(tmp_path, forged))
    starts = [
        f'monitor/verdict: {name}: recorded nothing, from the truth [' for name in SPECS[kept:]
    ]
    assert len(found['verdict']) == len(starts)
    assert all(map(str.startswith, found['verdict'], starts))


def _with_verdict(
    sample: Sample, kept: int = 2, reading: dict[str, object] | None = None, **values: object
) -> Sample:
    """The sample; if it is the verdict, with the first formulas only and with other values.

    ``reading``: other values of the first formula.
    """
    name, stamp, cdr = sample
    if name != '/monitor/verdict':
        return sample
    kind = TYPES[name]
    verdict = store().deserialize_cdr(cdr, kind)
    verdict.specs = verdict.specs[:kept]
    for field, value in values.items():
        setattr(verdict, field, value)
    for field, value in (reading or {}).items():
        setattr(verdict.specs[0], field, value)
    return name, stamp, serialise(verdict)


def test_given_time_that_goes_back_when_checked_then_it_is_told(tmp_path: Path) -> None:
    def late(messages: list[Sample]) -> list[Sample]:
        first = next(m for m in messages if m[0] == '/clock')
        return [*messages, first]

    found = wrong(rewritten(tmp_path, late))
    assert found['stamps'] == ['/clock at 0.000 s: stamp goes back from 1500000000 ns']


def test_given_a_message_that_cannot_be_decoded_when_checked_then_it_is_told(
    tmp_path: Path,
) -> None:
    def broken(messages: list[Sample]) -> list[Sample]:
        return [(n, t, b'\0\1\0\0' if (n, t) == ('/clock', STEP_NS) else c) for n, t, c in messages]

    found = wrong(rewritten(tmp_path, broken))
    assert set(found) == {'stamps', 'steps'}
    assert found['stamps'][0].startswith('/clock at 0.100 s: topic /clock: not a rosgraph_msgs')


def test_given_a_run_cut_off_when_checked_then_the_end_is_missed(run: Path, tmp_path: Path) -> None:
    data = run.read_bytes()
    (tmp_path / 'r').mkdir()
    (tmp_path / 'r' / 'r_0.mcap').write_bytes(data[:chunks_of(data)[9][1] + 20])
    found = wrong(check_bag(tmp_path / 'r'))
    assert set(found) == {'bytes', 'description', 'steps'}
    assert found['description'] == ['metadata.yaml: missing, so the recording was not finished']
    assert found['steps'] == [
        'run_status: 0 messages, not 1; the bag ends before the run does'
    ]


@pytest.mark.parametrize(('old', 'new', 'reason'), [
    ('message_count: 135', 'message_count: 134', 'message_count is 134, in the bag 135'),
    ('message_count: 16', 'message_count: 15', "'topics_with_message_count' differs from the desc"),
    ('depth: 16', 'depth: 10', "'topics_with_message_count' differs from the desc"),
    ('- run_0.mcap', '- ../../etc/passwd', 'relative_file_paths is'),
    ('name: /clock', 'name: /clocks', "'topics_with_message_count' differs from"),
    ('version: 9', 'version: 10', 'version is 10; known up to 9'),
    ('nanoseconds: 1500000000', 'nanoseconds: 15', "'duration' differs from the description"),
])
def test_given_a_description_that_lies_when_checked_then_it_is_told(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    folder = write_run(tmp_path / 'run').parent
    text = (folder / 'metadata.yaml').read_text()
    assert old in text
    (folder / 'metadata.yaml').write_text(text.replace(old, new, 1))
    found = wrong(check_bag(folder))
    assert set(found) == {'description'}
    assert any(reason in what for what in found['description'])


def test_given_a_wrong_type_hash_when_checked_then_its_topic_is_named(tmp_path: Path) -> None:
    topics = [
        replace(topic, type_hash=f'RIHS01_{"0" * 64}') if topic.name == '/clock' else topic
        for topic in run_topics()
    ]
    with BagWriter(
        tmp_path / 'run', topics, metadata={}, attachments={}, min_free_bytes=0
    ) as bag:
        for topic, stamp_ns, cdr in run_messages():
            bag.write(topic, cdr, stamp_ns)
    found = wrong(check_bag(tmp_path / 'run'))
    assert set(found) == {'types'}
    assert found['types'][0].startswith('/clock: type hash RIHS01_000')


def test_given_nothing_readable_when_checked_then_empty(tmp_path: Path) -> None:
    (tmp_path / 'x.mcap').write_bytes(MAGIC + b'\1' * 30)
    with pytest.raises(BagEmpty, match='at byte'):
        check_bag(tmp_path / 'x.mcap')


@pytest.mark.parametrize(('numbers', 'words'), [
    ([], ''), ([3], '3'), ([9, 7, 8, 3], '3, 7-9'),
    (range(0, 40, 2), '0, 2, 4, 6, 8, 10 and 14 more'),
])
def test_given_numbers_when_put_into_words_then_neighbours_go_together(
    numbers: list[int], words: str
) -> None:
    assert ranges(numbers) == words
