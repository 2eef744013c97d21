"""Mutants of every file that is read: our typed errors of one line, or a result; see fuzz_watch."""

from __future__ import annotations

import copy
import json
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml
from fuzz_mutations import mutants
from fuzz_targets import TARGETS
from fuzz_watch import end_of, watched
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from taxinet_ros.trials.record.table import read_table

pytestmark = pytest.mark.nightly

MUTANTS = {'metadata.yaml': 15}
"""Those of a target, where it takes longer; a millisecond is what YAML costs per few words."""

STRUCTURED = ('model card', 'onnx description', 'experiment', 'spec file',
              'learned.json', 'bench report')  # fmt: skip

FOUND = [
    ('entries of a record', b'[' * 3000),
    ('learned.json', b'[' * 3000),
    ('bench report', b'[' * 3000),
    ('analysis.json', b'[' * 3000),
    ('model card', b'[' * 3000),
    ('onnx description', b'input: !!bool x'),
    ('onnx description', b'input:\n  colour: ' + b'[' * 3000),
    ('onnx description', b'a: &a [x]\nb: [*a, *a]'),
    ('experiment', b'runs: !!int ""'),
    ('experiment', b'arms: {a: &a {}, b: *a}'),
    ('experiment', b'arms:\n  <<: {}'),
    ('spec file', b'specs:\n  long: abs(cte) < ' + b'9' * 5000 + b' then'),
    ('spec file', b'specs: !!bool x'),
    ('spec file', b'"a\\nb": 1'),
    ('metadata.yaml', b'rosbag2_bagfile_information: ' + b'[' * 3000),
]
"""What mutants have found: each let out a foreign error, more than a line, or took seconds."""

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
    | st.sampled_from([2**63, -1, 10**400, '../x', 'a\nb', '\x1b[2J', '\udc80']),
    lambda inner: st.lists(inner, max_size=3)
    | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize('name', TARGETS)
def test_given_mutants_when_read_then_only_typed_errors_of_one_line_come(
    name: str, tmp_path: Path
) -> None:
    target = TARGETS[name]
    folders = [tmp_path / word for word in ('examples', 'place')]
    for folder in folders:
        folder.mkdir()
    corpus, read = target.examples(folders[0]), target.reader(folders[1])
    sound = Counter(end_of(lambda data=data: read(data)) for data in corpus)
    ends = Counter[str]()
    with watched(tmp_path):
        for data in mutants(corpus, MUTANTS.get(name, 100), seed=len(name), text=target.text):
            ends[end_of(lambda data=data: read(data))] += 1
    assert sound['ok'] > 0
    assert sum(ends.values()) >= MUTANTS.get(name, 100)


@pytest.mark.parametrize(('name', 'data'), FOUND)
def test_given_what_mutants_have_found_when_read_then_one_line_or_a_result(
    name: str, data: bytes, tmp_path: Path
) -> None:
    read = TARGETS[name].reader(tmp_path)
    assert end_of(lambda: read(data)) in ('ok', 'UsageError', 'BagCorrupt')


def test_given_a_table_whose_words_are_no_text_when_read_then_one_line(tmp_path: Path) -> None:
    words = pa.StringArray.from_buffers(1, pa.py_buffer(struct.pack('<ii', 0, 2)),
                                        pa.py_buffer(b'\xff\xfe'))
    pq.write_table(pa.table({'clouds': words}), tmp_path / 'runs.parquet')
    assert end_of(lambda: read_table(tmp_path)) == 'UsageError'


@pytest.fixture(scope='module')
def readers(tmp_path_factory) -> dict[str, tuple[list[Any], Callable[[bytes], object]]]:
    """Values of the sound examples, and the reader, by target."""
    found = {}
    for name in STRUCTURED:
        target, folder = TARGETS[name], tmp_path_factory.mktemp('structured')
        examples = tmp_path_factory.mktemp('examples')
        values = [yaml.safe_load(data) for data in target.examples(examples)]
        found[name] = values, target.reader(folder)
    return found


@pytest.mark.parametrize('name', STRUCTURED)
@given(data=st.data())
@settings(max_examples=60, suppress_health_check=[
    HealthCheck.too_slow, HealthCheck.function_scoped_fixture,
])
def test_given_a_value_of_another_kind_anywhere_when_read_then_one_line_or_a_result(
    name: str, readers: dict[str, Any], data: st.DataObject
) -> None:
    examples, read = readers[name]
    value = copy.deepcopy(data.draw(st.sampled_from(examples)))
    _put(value, data)
    text = json.dumps(value).encode()  # which is YAML too
    assert end_of(lambda: read(text)) in ('ok', 'UsageError')


def _put(value: Any, data: st.DataObject) -> None:
    """Put something in the place of something."""
    while True:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = data.draw(st.sampled_from(keys))
        inner = value[key]
        if not (isinstance(inner, dict | list) and inner) or data.draw(st.integers(0, 3)) == 0:
            value[key] = data.draw(JSON)
            return
        value = inner
