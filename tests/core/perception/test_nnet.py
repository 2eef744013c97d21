"""A .nnet file becomes the same network as ONNX; a damaged one is refused in one line."""

from __future__ import annotations

import contextlib
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from nnet_samples import TINY, sample

from taxinet_ros.api.run import render
from taxinet_ros.core.perception.onnx import nnet
from taxinet_ros.core.perception.onnx.network import OnnxNetwork, prepare
from taxinet_ros.core.perception.onnx.nnet import (
    DESCRIPTIONS,
    TINYTAXINET,
    Nnet,
    converted,
    description_of,
    read_nnet,
    write_converted,
)
from taxinet_ros.core.perception.onnx.sidecar import parse_sidecar
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError

FILE = Path('net.nnet')
SMALL = (6, 4, 3, 2)


def small_description() -> bytes:
    values = yaml.safe_load(TINYTAXINET)
    values['input'] |= {'height': 2, 'width': 3, 'brightest': {'block': 4, 'keep': 4}}
    return yaml.safe_dump(values).encode()


def network_of(text: str) -> OnnxNetwork:
    found = converted(
        FILE, text.encode(), Path('net.onnx'), small_description(), Path('small.yaml')
    )
    return OnnxNetwork(found.files)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), hidden=st.lists(st.integers(1, 9), max_size=3))
def test_given_any_network_when_converted_then_onnx_answers_as_the_sums_by_hand(seed, hidden):
    made = sample((6, *hidden, 2), seed)
    network = network_of(made.text())
    inputs = np.random.default_rng(seed).uniform(-3, 3, (20, 6))
    by_hand = np.array([made.answer(row) for row in inputs.tolist()])
    onnx = np.array([network.numbers(np.asarray(row[None], np.float32)) for row in inputs])
    scale = max(1.0, float(np.abs(by_hand).max()))
    assert onnx == pytest.approx(by_hand, abs=1e-4 * scale)
    read = Nnet.parse(FILE, made.text().encode())
    assert read.evaluate(inputs) == pytest.approx(by_hand, abs=1e-12 * scale)


def test_given_limits_then_an_input_beyond_them_counts_as_the_limit_itself():
    made = sample(SMALL)
    network = network_of(made.text())
    far = np.array([[1e6, -1e6] * 3], np.float32)
    edge = np.array([[made.high[0], made.low[1], made.high[2], made.low[3], made.high[4],
                      made.low[5]]], np.float32)
    assert network.numbers(far) == pytest.approx(network.numbers(edge))
    assert network.numbers(edge) != pytest.approx(network.numbers(np.zeros((1, 6), np.float32)))


def test_given_the_mean_and_range_of_the_outputs_then_all_answers_are_scaled_by_them():
    made = sample(SMALL, plain=True)
    inputs = np.full((1, 6), 0.4, np.float32)
    before = network_of(made.text()).numbers(inputs)
    made.means[-1], made.ranges[-1] = -7.0, 2.5
    assert network_of(made.text()).numbers(inputs) == pytest.approx(2.5 * before - 7.0, abs=1e-5)


def test_given_the_same_file_then_the_same_bytes():
    text = sample(SMALL).text().encode()
    one, other = (Nnet.parse(FILE, text).to_onnx() for _ in range(2))
    assert one == other


def test_given_the_published_description_then_a_frame_gets_the_answer_of_its_picture(tmp_path):
    made = sample(TINY, plain=True)
    content, source = description_of('tinytaxinet')
    write_converted(
        converted(FILE, made.text().encode(), tmp_path / 'tiny.onnx', content, source)
    )
    frame = render(Scenario(cross_track_m=2.0))
    picture = prepare(frame, parse_sidecar(source, content))[0]
    assert picture.shape == (128,)
    assert (float(picture.min()) >= 0.0, float(picture.max()) <= 1.0) == (True, True)
    assert float(picture.mean()) == pytest.approx(0.5, abs=0.02)
    cte_m, he_deg = made.answer(picture.tolist())
    found = make_perception(str(tmp_path / 'tiny.onnx')).estimate(frame, None)
    assert found.cte_m == pytest.approx(cte_m, abs=1e-4)
    assert np.degrees(found.he_rad) == pytest.approx(he_deg, abs=1e-4)


@pytest.mark.parametrize('form', ['no commas at the ends', 'CRLF', 'other comments', 'no comment'])
def test_given_another_way_of_writing_then_the_network_is_the_same(form):
    text = sample(SMALL).text()
    other = {
        'no commas at the ends': text.replace(',\n', '\n'),
        'CRLF': text.replace('\n', '\r\n'),
        'other comments': '// é by somebody\n' + text,
        'no comment': '\n'.join(text.splitlines()[2:]) + '\n\n',
    }[form]
    one, same = (Nnet.parse(FILE, each.encode()) for each in (text, other))
    assert one.to_onnx().split(b'SHA-256')[0] == same.to_onnx().split(b'SHA-256')[0]
    assert (one.evaluate(np.ones((1, 6))) == same.evaluate(np.ones((1, 6)))).all()


def edited(line: int, new: str) -> str:
    """The small sample with one of its lines (from 1) replaced."""
    lines = sample(SMALL).text().splitlines()
    lines[line - 1] = new
    return '\n'.join(lines)


LINES = sample(SMALL).text().splitlines()
DAMAGE = {
    'empty': ('', 'is empty'),
    'a web page': ('<!DOCTYPE html>\n<html>', 'is a web page; download the raw file'),
    'a pointer': ('version https://git-lfs.github.com/spec/v1\n', 'Git LFS pointer'),
    'binary': ('\0\1\2', 'is not text'),
    'comments only': ('// nothing\n', 'ends after line 1, before its header'),
    'header too short': (edited(3, '3,6,2,'), 'line 3: header: expected 4 numbers, got 3'),
    'header in words': (edited(3, 'a,6,2,6,'), "line 3: header: expected a number, got 'a'"),
    'half a layer': (edited(3, '2.5,6,2,6,'), 'line 3: header: 2.5 is not a whole number'),
    'no layers': (edited(3, '0,6,2,6,'), 'line 3: header: 0 is not a whole number of at least 1'),
    'a thousand layers': (edited(3, '1000,6,2,6,'), 'the header says 1000 layers; at most 100'),
    'other inputs': (edited(3, '3,5,2,6,'), 'line 4: the layer sizes have 6 inputs, the header'),
    'other outputs': (edited(3, '3,6,3,6,'), 'have 2 outputs, the header says 3'),
    'other largest': (edited(3, '3,6,2,9,'), 'have 6 neurons in the largest layer'),
    'huge layer': (edited(4, '6,99999999,3,2,'), 'a layer has 99999999 neurons; at most 65536'),
    'flag': (edited(5, '7,'), 'line 5: the flag is 7, expected 0 or 1; is a line missing?'),
    'minima short': (edited(6, '0,0,'), 'line 6: minima: expected 6 numbers, got 2'),
    'swapped limits': (edited(7, '-9,' * 6), 'line 7: input 1 has its maximum -9 below'),
    'means without the output': (edited(8, '0,' * 6), 'line 8: means: expected 7 numbers, got 6'),
    'range 0': (edited(9, '1,1,1,0,1,1,1,'), 'line 9: range 4 is 0, which divides by 0'),
    'nan': (edited(10, 'nan,' * 6), 'line 10: weights of layer 1, row 1: expected a number, got'),
    'infinite': (edited(10, '1e999,' * 6), 'line 10: weights of layer 1, row 1: 1e999 is beyond'),
    'beyond 32 bits': (edited(10, '1e39,' * 6), '1e39 is beyond the range of 32 bits'),
    'python number': (edited(10, '1_0,' * 6), "expected a number, got '1_0'"),
    'short row': (edited(12, '1,2,3,'), 'line 12: weights of layer 1, row 3: expected 6 numbers'),
    'two biases': (edited(14, '1,2,'), 'line 14: bias 1 of layer 1: expected 1 number, got 2'),
    'cut off': ('\n'.join(LINES[:-1]), f'ends after line {len(LINES) - 1}, before its bias 2 of'),
    'cut amid a row': ('\n'.join([*LINES[:19], LINES[19][:25]]), 'line 20: weights of layer 2'),
    'two files': (sample(SMALL).text() * 2, f'line {len(LINES) + 1}: more numbers than'),
    'a line lost': ('\n'.join(LINES[:10] + LINES[11:]), 'line 13: weights of layer 1, row 4'),
}


@pytest.mark.parametrize('case', DAMAGE)
def test_given_a_damaged_file_then_one_line_says_where_and_what(case):
    text, expected = DAMAGE[case]
    with pytest.raises(UsageError) as caught:
        network_of(text)
    line = str(caught.value)
    assert line.startswith('nnet: net.nnet: ')
    assert expected in line
    assert '\n' not in line


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_given_any_cut_or_changed_byte_then_it_is_read_or_refused_and_nothing_else(data):
    text = sample(SMALL).text()
    at = data.draw(st.integers(0, len(text) - 1))
    letter = data.draw(st.sampled_from('0,.-e\n x'))
    for broken in (text[:at], text[:at] + letter + text[at + 1:]):
        with contextlib.suppress(UsageError):  # any other error fails the test
            assert Nnet.parse(FILE, broken.encode()).sizes[-1] >= 1


def test_given_a_description_of_another_network_then_the_line_says_what_differs():
    text = sample(SMALL).text().encode()
    with pytest.raises(UsageError, match=r'input is flat \(1, 128\), but net.nnet takes 6 numbers'):
        converted(FILE, text, Path('net.onnx'), *description_of('tinytaxinet'))
    wrong = sample((6, 4, 3)).text().encode()
    with pytest.raises(UsageError, match=r'outputs has 2 entries, but net\.nnet gives 3 numbers'):
        converted(FILE, wrong, Path('net.onnx'), small_description(), Path('small.yaml'))
    with pytest.raises(UsageError, match='description tiny: neither tinytaxinet nor a readable'):
        description_of('tiny')
    assert list(DESCRIPTIONS) == ['tinytaxinet']


def test_given_weights_that_cancel_then_what_32_bits_lose_is_not_silent():
    made = sample((6, 2, 2), plain=True)
    made.weights[0][:] = 1e9
    made.biases[0][:] = [0.0, 1.0]
    made.weights[1][:] = [[1e9, -1e9], [1.0, 0.0]]
    with pytest.raises(UsageError, match='as ONNX, in 32 bits, its answers differ by up to'):
        network_of(made.text())


def test_given_limits_or_weights_beyond_what_32_bits_hold_then_one_line_and_no_warning():
    small = sample(SMALL)
    wide = dataclasses.replace(small, low=[-3e38] * 6, high=[3e38] * 6)
    weights = [np.full_like(one, 3e38) for one in small.weights]
    for odd, said in (
        (wide, 'not finite for inputs within its limits, -3e[+]38 to 3e[+]38; correct minima'),
        (dataclasses.replace(small, ranges=[1e-300] * 7), 'finite'),
        (dataclasses.replace(small, weights=weights), 'finite'),
    ):
        with pytest.raises(UsageError, match=said) as caught:
            network_of(odd.text())
        assert '\n' not in str(caught.value)


def test_given_the_largest_file_then_its_numbers_are_read_whole_lines_at_a_time(monkeypatch):
    wide = sample((200, 150, 2))
    alone = []
    number = nnet._Lines._number
    monkeypatch.setattr(
        nnet._Lines, '_number',
        lambda lines, name, word: alone.append(word) or number(lines, name, word),
    )
    read = Nnet.parse(FILE, wide.text().encode())
    assert alone == []
    assert (read.weights[0] == wide.weights[0]).all()
    # In another way of writing, each number is read on its own, to the same value.
    odd = wide.text().replace(',', ',\x0b')
    assert (Nnet.parse(FILE, odd.encode()).weights[0] == wide.weights[0]).all()
    assert len(alone) > 30_000


@settings(max_examples=300, deadline=None)
@given(st.text('0123456789.+-eE _\t\xb2n', max_size=8))
def test_given_any_word_then_a_whole_line_reads_it_as_the_strict_pattern_does(word):
    text = edited(10, ','.join([word, *['1'] * 5, '']))
    try:
        found = Nnet.parse(FILE, text.encode('latin-1')).weights[0][0, 0]
    except UsageError:
        assert not (nnet._NUMBER.fullmatch(word.strip()) and abs(float(word)) < 3e38)
    else:
        assert nnet._NUMBER.fullmatch(word.strip())
        assert found == float(word)


def test_given_a_file_without_an_end_or_too_large_then_one_line_and_little_is_read(tmp_path):
    large = tmp_path / 'large.nnet'
    with large.open('wb') as file:
        file.truncate(nnet.MAX_NNET_BYTES + 1)
    for read, name in ((read_nnet, Path), (description_of, str)):
        with pytest.raises(UsageError, match='is a device, not a regular file'):
            read(name('/dev/zero'))
        with pytest.raises(UsageError, match=r'has more than (8 M|16 K)iB; is it the right file'):
            read(name(large))


def test_given_no_file_or_a_folder_then_one_line(tmp_path):
    with pytest.raises(UsageError, match=r'lost\.nnet: cannot be read \(No such file'):
        read_nnet(tmp_path / 'lost.nnet')
    with pytest.raises(UsageError, match='cannot be read'):
        read_nnet(tmp_path)


@pytest.mark.parametrize('end', ['\n', '\r\n', '\r'])
def test_given_comments_whose_bytes_are_line_ends_in_latin_1_then_the_file_is_read(end):
    text = sample(SMALL).text(comments=('// Ångström … \x0c', '// à'))
    assert b'\x85' in text.encode()
    nnet = Nnet.parse(FILE, text.replace('\n', end).encode())
    assert nnet.sizes == SMALL
