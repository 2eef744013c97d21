"""What is said of bags that genuine ``ros2 bag record`` has made (``tests/bag/genuine``)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import zstandard

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.run.recording import open_recording

GENUINE = Path(__file__).resolve().parents[1] / 'genuine'
OURS = GENUINE / 'plain-00000'
"""The run of ``plain`` by our recorder."""
STEPS = 31
WHOLE = {
    'plain': {'plain-00000': 'SATISFIED'},
    'two_runs': {'near-00000': 'SATISFIED', 'far-00000': 'VIOLATED'},
}
SILENT = {'/events/write_split', '/obituary', '/timing'}
"""Topics that somebody offers, and on which nothing was said."""
COMPRESSED = ('file', 'message')


def document(taxinet: Callable[..., tuple[int, str, str]], *words: object) -> tuple[int, Any]:
    """Exit code and JSON of a command."""
    code, out, _ = taxinet(*words, '--json')
    return code, json.loads(out)


@pytest.mark.parametrize('name', WHOLE)
def test_ros6_given_runs_by_the_wall_clock_then_each_is_told_judged_and_whole(name, taxinet):
    bag, runs = GENUINE / name, WHOLE[name]
    code, told = document(taxinet, 'bag', 'info', bag)
    assert (code, told['whole'], told['own_recorder']) == (0, True, False)
    assert [(one['run_id'], one['steps']) for one in told['runs']] == [(run, STEPS) for run in runs]
    code, judged = document(taxinet, 'monitor', bag)
    assert code == ('VIOLATED' in runs.values())
    verdicts = [one['verdicts'][0] for one in judged['bags']]
    assert [one['verdict'] for one in verdicts] == [*runs.values()]
    assert all(one['as_recorded'] for one in verdicts)
    code, out, _ = taxinet('doctor', bag)
    assert (code, out.splitlines()[-1]) == (0, 'nothing is wrong')
    for run in runs:
        assert f'{run}: {STEPS} control steps, every topic in each' in out


def test_ros6_given_topics_without_a_message_then_the_description_alone_tells_of_them(
    tmp_path, taxinet
):
    bag = shutil.copytree(GENUINE / 'plain', tmp_path / 'plain')
    described = (bag / 'metadata.yaml').read_text()
    assert all(f'name: {topic}\n' in described for topic in SILENT)
    assert SILENT.isdisjoint(topic.name for topic in open_recording(bag).info.topics)
    code, out, _ = taxinet('doctor', bag)
    assert (code, 'nothing is wrong' in out) == (0, True)


def test_ros6_given_a_run_of_either_recorder_then_they_compare_export_and_split_alike(
    tmp_path, taxinet
):
    theirs = GENUINE / 'plain'
    assert taxinet('bag', 'compare', theirs, OURS)[0] == 0
    tables = []
    for bag in (theirs, OURS):
        tables.append(tmp_path / f'{bag.name}.csv')
        assert taxinet('bag', 'export', bag, '--out', tables[-1])[0] == 0
    read = [pd.read_csv(table, comment='#') for table in tables]
    assert len(read[0]) == STEPS
    pd.testing.assert_frame_equal(*read)
    assert taxinet('bag', 'split', theirs, '--out', tmp_path / 'runs')[0] == 0
    new = tmp_path / 'runs' / OURS.name
    assert all(topic.equal for topic in compare_bags(OURS, new))
    assert open_recording(new).plain
    assert taxinet('doctor', new)[0] == 0


def test_ros6_given_the_simulators_clock_then_the_first_run_lacks_its_beginning_and_the_next_not(
    taxinet
):
    bag = GENUINE / 'sim_time'
    code, out, _ = taxinet('monitor', bag)
    assert code == 1
    assert 'sim_time near-00000  near  INCOMPLETE' in out
    assert 'begins at 0.7 s: earlier steps were not recorded' in out
    assert 'sim_time far-00000  near  VIOLATED    rho    -2.000' in out
    code, out, _ = taxinet('doctor', bag)
    assert code == 3
    assert f'ok   lockstep    far-00000: {STEPS} control steps, every topic in each' in out
    assert f'BAD  lockstep    near-00000: {STEPS} control steps, every topic in each' in out


def test_ros6_given_a_recorder_that_was_too_slow_then_no_verdict_and_the_steps_by_number(taxinet):
    code, told = document(taxinet, 'monitor', GENUINE / 'lossy')
    assert (code, told['bags'][0]['verdicts'][0]['verdict']) == (3, 'INCOMPLETE')
    code, out, _ = taxinet('doctor', GENUINE / 'lossy')
    assert code == 3
    assert 'step 0-20: without' in out


@pytest.mark.parametrize('name', COMPRESSED)
@pytest.mark.parametrize('words', [
    ('monitor',), ('bag', 'info'), ('bag', 'recover', '--out', 'new'),
], ids=lambda words: words[-1] if len(words) < 3 else words[1])
def test_ros6_given_a_compressed_bag_then_one_line_gives_the_command_and_nothing_is_written(
    name, words, tmp_path, taxinet
):
    bag = GENUINE / name
    for place in (bag, next(bag.glob('*.mcap*'))):
        code, out, err = taxinet(*words, place)
        assert (code, out, len(err.splitlines())) == (2, '', 1)
        # Of a file alone genuine ros2 bag convert does not know that it is compressed.
        assert f'compressed by {name}; decompress it: ros2 bag convert -i {bag} -o' in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(('name', 'fix'), [
    ('file', 'unzstd {bag}/*.mcap.zstd'),
    ('message', 'ros2 bag reindex {bag}; "compression_mode: MESSAGE" and'),
])
def test_ros6_given_a_compressed_bag_without_its_description_then_the_command_is_another(
    name, fix, tmp_path, taxinet
):
    bag = shutil.copytree(GENUINE / name, tmp_path / name)
    (bag / 'metadata.yaml').unlink()
    code, _, err = taxinet('monitor', bag)
    assert code == 2
    assert f'compressed by {name}; decompress it: {fix.format(bag=bag)}' in err


def test_ros6_given_a_file_that_was_unpacked_beside_itself_then_it_is_read_and_nothing_is_wrong(
    tmp_path, taxinet
):
    bag = shutil.copytree(GENUINE / 'file', tmp_path / 'file')
    packed = bag / 'file_0.mcap.zstd'
    raw = zstandard.ZstdDecompressor().decompressobj().decompress(packed.read_bytes())
    packed.with_suffix('').write_bytes(raw)
    code, out, _ = taxinet('doctor', bag)
    assert (code, out.splitlines()[-1]) == (0, 'nothing is wrong')
    # A recorder that is killed has packed all of its files but the last.
    shutil.copy(packed, bag / 'file_1.mcap.zstd')
    code, _, err = taxinet('monitor', bag)
    assert (code, 'compressed by file' in err) == (2, True)
