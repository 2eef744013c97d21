"""The doctor: a whole run passes every check, and each thing that can be wrong is found once."""

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
from taxinet_ros.bag.check.findings import RECOVER, RERUN, ranges
from taxinet_ros.bag.errors import BagEmpty
from taxinet_ros.bag.storage.records import MAGIC
from taxinet_ros.bag.writer import BagWriter

STEP_NS = 100_000_000
TRUTH = '/ground_truth/tracking_error'
Messages = list[Sample]


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(tmp_path_factory.mktemp('run') / 'run')


def wrong(checkup: Checkup) -> dict[str, list[str]]:
    """Findings by check, as text."""
    return {
        check.name: [f'{found.where}: {found.what}' for found in check.findings]
        for check in checkup.checks if check.findings
    }


def rewritten(tmp_path: Path, change: Callable[[Messages], Messages]) -> Checkup:
    """The checkup of a run with other messages."""
    return check_bag(write_run(tmp_path / 'run', change(list(run_messages()))).parent)


def test_given_a_whole_run_when_checked_then_nothing_is_wrong(run: Path) -> None:
    assert len(run_messages()) == 168 == 1 + 4 + 1 + PER_STEP * STEPS + 2
    for path in (run, run.parent):
        checkup = check_bag(path)
        names = [check.name for check in checkup.checks if not check.skipped]
        assert names == ['bytes', 'structure', 'lockstep', 'verdict']
        assert wrong(checkup) == {}


def test_given_a_flipped_byte_when_checked_then_its_place_and_what_fixes_it_are_told(
    run: Path, tmp_path: Path
) -> None:
    data = bytearray(run.read_bytes())
    data[len(data) // 2] ^= 4
    (tmp_path / 'x.mcap').write_bytes(data)
    (found,) = check_bag(tmp_path / 'x.mcap').findings
    assert found.where.startswith('x.mcap, byte ')
    assert found.fix == RECOVER


def test_given_a_run_cut_off_when_checked_then_that_is_one_finding(
    run: Path, tmp_path: Path
) -> None:
    data = run.read_bytes()
    (tmp_path / 'r').mkdir()
    (tmp_path / 'r' / 'r_0.mcap').write_bytes(data[:chunks_of(data)[9][1] + 20])
    checkup = check_bag(tmp_path / 'r')
    assert list(wrong(checkup)) == ['bytes']
    assert len(checkup.findings) == 1
    (steps,) = [check.looked_at for check in checkup.checks if check.name == 'lockstep']
    assert steps.endswith('; the end of the run is not recorded')


def without(name: str, *steps: int) -> Callable[[Messages], Messages]:
    return lambda messages: [
        m for m in messages if m[0] != name or m[1] // STEP_NS not in steps
    ]


def twice(messages: Messages) -> Messages:
    place = next(k for k, m in enumerate(messages) if m[:2] == ('/clock', 2 * STEP_NS))
    return [*messages[:place], messages[place], *messages[place:]]


def late(messages: Messages) -> Messages:
    return [*messages, next(m for m in messages if m[0] == '/clock')]


def torn(messages: Messages) -> Messages:
    return [(n, t, b'\0\1\0\0' if (n, t) == ('/clock', STEP_NS) else c) for n, t, c in messages]


@pytest.mark.parametrize(('change', 'expected'), [
    (without('/clock', 4), 'step 4: without /clock'),
    (without('/camera/image_raw', 3, 5, 6), 'step 3, 5-6: without /camera/image_raw'),
    (twice, 'step 2: /clock more than 1 x'),
    (late, '/clock: at 0.000 s: stamp goes back from 1500000000 ns'),
    (torn, '/clock: at 0.100 s: topic /clock: not a rosgraph_msgs'),
    (without('/run_status', STEPS - 1),
     'run_status: 0 messages, not 1; the bag ends before the run does'),
    (without('/scenario', 0), 'scenario: 0 messages, not 1; nothing tells what was run'),
])
def test_given_messages_that_are_lost_doubled_or_wrong_when_checked_then_that_is_one_finding(
    tmp_path: Path, change: Callable[[Messages], Messages], expected: str
) -> None:
    checkup = rewritten(tmp_path, change)
    (text,) = wrong(checkup)['lockstep']
    assert text.startswith(expected)
    fix = '' if 'nothing tells' in expected else RERUN
    assert [found.fix for found in checkup.findings] == [fix]


def test_given_a_command_lost_when_checked_then_the_verdict_is_not_judged_beyond_it(
    tmp_path: Path,
) -> None:
    found = wrong(rewritten(tmp_path, without('/taxi_command', 4)))
    assert found == {
        'lockstep': ['step 4: without /taxi_command'],
        'verdict': ['step 4: no samples from here on'],
    }


def test_given_another_truth_when_checked_then_the_verdict_does_not_follow(tmp_path: Path) -> None:
    def shifted(messages: Messages) -> Messages:
        return [
            (name, stamp, cdr[:-56] + struct.pack('<d', 9.5) + cdr[-48:])
            if (name, stamp) == (TRUTH, (STEPS - 1) * STEP_NS) else (name, stamp, cdr)
            for name, stamp, cdr in messages
        ]

    found = wrong(rewritten(tmp_path, shifted))
    assert set(found) == {'verdict'}
    assert any(text.startswith(f'step {STEPS - 1}: phi_eventually') for text in found['verdict'])
    assert any('monitor/verdict' in text for text in found['verdict'])


@pytest.mark.parametrize(('values', 'reading', 'expected'), [
    ({'left_runway': True}, {}, 'left_runway: recorded True, from the messages '),
    ({'max_cross_track_error': 99.0}, {}, 'max_cross_track_error: recorded 99.0, from the '),
    ({'satisfied': False}, {}, 'satisfied: recorded False, from the messages '),
    ({}, {'verdict': 2}, 'phi_eventually: verdict: recorded 2, from'),
    ({}, {'final': False}, 'phi_eventually: final: recorded False, from'),
    ({}, {'formula': 'always(x > 1)'}, "phi_eventually: formula: recorded 'always(x > 1)', from"),
])
def test_given_a_verdict_with_another_figure_when_checked_then_it_is_named(
    tmp_path: Path, values: dict[str, object], reading: dict[str, object], expected: str
) -> None:
    found = wrong(rewritten(tmp_path, lambda all_: [
        _with_verdict(sample, reading=reading, **values) for sample in all_
    ]))
    assert set(found) == {'verdict'}
    (text,) = found['verdict']
    assert text.startswith(f'monitor/verdict: {expected}')


@pytest.mark.parametrize('kept', [0, 1])
def test_given_a_verdict_without_a_formula_when_checked_then_it_is_named(
    tmp_path: Path, kept: int
) -> None:
    found = wrong(rewritten(tmp_path, lambda all_: [
        _with_verdict(sample, kept=kept) for sample in all_
    ]))
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
    verdict = store().deserialize_cdr(cdr, TYPES[name])
    verdict.specs = verdict.specs[:kept]
    for field, value in values.items():
        setattr(verdict, field, value)
    for field, value in (reading or {}).items():
        setattr(verdict.specs[0], field, value)
    return name, stamp, serialise(verdict)


@pytest.mark.parametrize(('old', 'new', 'reason'), [
    ('message_count: 168', 'message_count: 134', 'message_count is 134, in the bag 168'),
    ('message_count: 16\n', 'message_count: 15\n', "'topics_with_message_count' differs from"),
    ('depth: 16', 'depth: 10', "'topics_with_message_count' differs from the desc"),
    ('- run_0.mcap', '- ../../etc/passwd', 'relative_file_paths is'),
    ('name: /clock', 'name: /clocks', "'topics_with_message_count' differs from"),
    ('version: 9', 'version: 10', 'version is 10; known up to 9'),
    ('nanoseconds: 1500000000', 'nanoseconds: 15', "'duration' differs from the description"),
    ('1.2.3', '1.2.4', "'custom_data' differs from the description"),
    ('rosbag2_bagfile_information', 'x', 'not a bag description'),
])
def test_given_a_description_that_lies_when_checked_then_it_is_told(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    folder = write_run(tmp_path / 'run').parent
    text = (folder / 'metadata.yaml').read_text()
    assert old in text
    (folder / 'metadata.yaml').write_text(text.replace(old, new, 1))
    checkup = check_bag(folder)
    whole = not {'message_count is 134', 'not a bag description'} & {reason.split(',')[0]}
    assert checkup.info.complete is whole
    assert set(wrong(checkup)) == {'structure'}
    assert any(reason in found.what for found in checkup.findings)
    assert {found.fix for found in checkup.findings} == {RECOVER}


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
    assert set(found) == {'structure'}
    assert found['structure'][0].startswith('/clock: type hash RIHS01_000')


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
