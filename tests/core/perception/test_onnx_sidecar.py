from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from onnx_samples import DESCRIPTION, described

from taxinet_ros.core.perception.onnx.sidecar import Brightest, Output, Sidecar, parse_sidecar
from taxinet_ros.errors import UsageError

FILE = Path('net.yaml')
MANUAL = Path(__file__).parents[3] / 'docs' / 'onnx.md'


def parse(changes: dict[str, Any] | None = None) -> Sidecar:
    return parse_sidecar(FILE, yaml.safe_dump(described(changes)).encode())


def complaint(data: bytes) -> str:
    with pytest.raises(UsageError) as caught:
        parse_sidecar(FILE, data)
    message = str(caught.value)
    assert '\n' not in message
    assert len(message) < 400
    assert message.startswith('onnx: net.yaml: ')
    return message.removeprefix('onnx: net.yaml: ')


def test_given_the_least_description_when_read_then_the_rest_is_the_plain_choice() -> None:
    read = parse({'input.resize': None})
    assert read.picture.crop == (0, 0, 360, 200)
    assert (read.picture.resize, read.picture.brightest, read.picture.name) == ('area', None, None)
    assert (read.scaling.per_image, read.scaling.clip) == ('none', None)
    assert (read.scaling.mean, read.scaling.std) == ((0.0,), (1.0,))
    assert read.outputs[0] == Output(quantity='cte', scale=10.0)
    assert read.outputs[1].scale == pytest.approx(math.radians(30))


def test_given_a_view_when_read_then_it_is_kept_and_what_it_excludes_is_refused() -> None:
    seen = {'input.view': 'ahead', 'input.height': 64, 'input.width': 192, 'input.resize': None}
    assert parse(seen).picture.view == 'ahead'
    assert parse().picture.view is None
    for changes, why in (
        ({'input.view': 'behind'}, 'ahead'),
        ({'input.crop': [0, 0, 9, 9]}, 'input.crop: has no effect with a view'),
        ({'input.height': 32}, 'is grey, 32 x 192; the picture of a view is grey, 64 x 192'),
    ):
        said = complaint(yaml.safe_dump(described(seen | changes)).encode())
        assert why in said


def test_given_every_key_when_read_then_every_value_is_kept() -> None:
    read = parse({
        'input.name': 'picture', 'input.colour': 'bgr', 'input.layout': 'nhwc',
        'input.crop': [1, 2, 30, 40], 'input.brightest': {'block': 8, 'keep': 5},
        'input.resize': 'cubic', 'scaling.per_image': 'centre', 'scaling.mean': [1, 2, 3],
        'scaling.std': [4, 5, 6], 'scaling.clip': [-1, 0.5], 'outputs.0.offset': 0.25,
    })
    assert read.picture.name == 'picture'
    assert read.picture.shape == (1, 4, 6, 3)
    assert read.picture.crop == (1, 2, 30, 40)
    assert read.picture.brightest == Brightest(block=8, keep=5)
    assert (read.picture.resize, read.scaling.per_image) == ('cubic', 'centre')
    assert (read.scaling.mean, read.scaling.std) == ((1, 2, 3), (4, 5, 6))
    assert read.scaling.clip == (-1, 0.5)
    assert read.outputs[0].offset == 0.25


@pytest.mark.parametrize(
    ('layout', 'shape'),
    [('nchw', (1, 1, 4, 6)), ('nhwc', (1, 4, 6, 1)), ('flat', (1, 24))],
)
def test_given_a_layout_when_read_then_the_shape_is_the_models(
    layout: str, shape: tuple[int, ...]
) -> None:
    assert parse({'input.layout': layout}).picture.shape == shape


@pytest.mark.parametrize(
    ('unit', 'positive', 'factor'),
    [('rad', 'left', 1.0), ('rad', 'right', -1.0), ('deg', 'right', -math.pi / 180)],
)
def test_given_unit_and_sign_when_read_then_scale_and_offset_are_rad_left_positive(
    unit: str, positive: str, factor: float
) -> None:
    read = parse({'outputs.1': {
        'quantity': 'heading_error', 'unit': unit, 'positive': positive, 'scale': 2, 'offset': 3,
    }})
    assert read.outputs[1].scale == pytest.approx(2 * factor)
    assert read.outputs[1].offset == pytest.approx(3 * factor)


REQUIRED = [
    'input', 'scaling', 'outputs', 'input.layout', 'input.colour', 'input.height', 'input.width',
    'scaling.divide_by', 'outputs.0.quantity', 'outputs.0.unit', 'outputs.0.positive',
    'outputs.0.scale',
]


@pytest.mark.parametrize('key', REQUIRED)
def test_given_a_key_left_out_when_read_then_it_is_named_and_what_to_write(key: str) -> None:
    said = complaint(yaml.safe_dump(described({key: None})).encode())
    section, _, name = key.replace('.0.', '[0].').rpartition('.')
    assert said.removeprefix(f'{section}: ').startswith(f'the key {name!r} is missing; expected ')


@pytest.mark.parametrize('section', ['', 'input.', 'scaling.', 'outputs.0.'])
def test_given_an_unknown_key_when_read_then_it_is_named_with_the_known_ones(section: str) -> None:
    said = complaint(yaml.safe_dump(described({f'{section}colr': 1})).encode())
    assert f'{section.replace(".0.", "[0].")}colr: unknown key; known: ' in said


CTE = DESCRIPTION['outputs'][0]
WRONG: list[tuple[str, Any, str]] = [
    ('input', [1], 'input: expected KEY: VALUE pairs with the keys name, layout'),
    ('outputs', {}, 'outputs: expected a list of entries with the keys quantity'),
    ('outputs', [], 'outputs: expected a list'),
    ('outputs.1', 'cte', 'outputs[1]: expected KEY: VALUE pairs with the keys quantity'),
    ('input.name', 3, 'input.name: expected text, got 3; put it in'),
    ('input.layout', 'NCHW', "input.layout: expected one of nchw, nhwc, flat, got 'NCHW'"),
    ('input.colour', ['rgb'], "input.colour: expected one of rgb, bgr, grey, got ['rgb']"),
    ('input.height', 0, 'input.height: expected a whole number, 1 to 4096, got 0'),
    ('input.height', True, 'input.height: expected a whole number, 1 to 4096, got True'),
    ('input.width', 4097, 'input.width: expected a whole number, 1 to 4096, got 4097'),
    ('input.resize', 'lanczos',
     "input.resize: expected one of area, linear, cubic, nearest, got 'lanczos'"),
    ('input.crop', [0, 0, 361, 200], 'numbers, 0 to 360, got [0, 0, 361, 200]'),
    ('input.crop', [0, 0, 360, 201],
     'input.crop: expected [left, top, right, bottom] in whole pixels'),
    ('input.crop', [5, 0, 5, 200], 'left < right <= 360 and top < bottom <= 200'),
    ('input.crop', [0, 7, 5, 6], 'left < right <= 360 and top < bottom <= 200'),
    ('input.crop', [0, 0.5, 360, 200], 'in whole pixels'),
    ('input.crop', [0, 0, 360], 'expected a list of 4 numbers'),
    ('input.brightest', {'block': 2, 'keep': 5},
     'brightest.keep: expected a whole number, 1 to 4, got 5'),
    ('input.brightest', {'block': 2},
     "brightest: the key 'keep' is missing; expected a whole number, 1 to 4"),
    ('scaling.divide_by', 0, 'scaling.divide_by: expected a number, 1e-06 to 1e+06, got 0'),
    ('scaling.divide_by', math.nan,
     'scaling.divide_by: expected a number, 1e-06 to 1e+06, got nan'),
    ('scaling.divide_by', 10**40, 'scaling.divide_by: expected a number, 1e-06 to 1e+06, got 1000'),
    ('scaling.per_image', 'yes',
     "scaling.per_image: expected one of none, centre, standardise, got 'yes'"),
    ('scaling.mean', [0.5], "scaling: the key 'std' is missing; expected a list of 1 number"),
    ('scaling.std', [0.5], "scaling: the key 'mean' is missing; expected a list of 1 number"),
    ('scaling.clip', [1, 1], 'scaling.clip: has its lowest value not below its highest'),
    ('outputs.0.unit', 'ft', "outputs[0].unit: expected m, got 'ft'"),
    ('outputs.1.unit', 'm', "outputs[1].unit: expected one of deg, rad, got 'm'"),
    ('outputs.0.positive', 'east', "outputs[0].positive: expected one of left, right, got 'east'"),
    ('outputs.0.scale', 0, 'outputs[0].scale: makes the output constant'),
    ('outputs.0.scale', math.inf, 'outputs[0].scale: expected a number, -1e+06 to 1e+06, got inf'),
    ('outputs.0.quantity', 'ignore', 'outputs[0].unit: has no meaning for an ignored'),
    ('outputs.1', CTE, 'outputs: has 2 entries with quantity cte; the steering needs one'),
    ('outputs', [CTE], 'outputs: has 0 entries with quantity heading_error'),
]


@pytest.mark.parametrize(('key', 'value', 'fragment'), WRONG)
def test_given_a_value_that_cannot_be_when_read_then_key_value_and_fix_are_named(
    key: str, value: Any, fragment: str
) -> None:
    assert fragment in complaint(yaml.safe_dump(described({key: value})).encode())


def test_given_a_colour_picture_when_its_numbers_do_not_fit_then_it_is_refused() -> None:
    said = complaint(yaml.safe_dump(described({
        'input.colour': 'rgb', 'scaling.mean': [0.5], 'scaling.std': [1]})).encode())
    assert 'scaling.mean: expected a list of 3 numbers, -1e+06 to 1e+06, got [0.5]' in said
    said = complaint(yaml.safe_dump(described({
        'input.colour': 'rgb', 'input.layout': 'flat'})).encode())
    assert said == 'input.layout: is flat, which is only for grey images; write nchw or nhwc'


def test_given_blocks_when_the_resized_frame_were_huge_then_it_is_refused() -> None:
    said = complaint(yaml.safe_dump(described({
        'input.brightest': {'block': 64, 'keep': 1}, 'input.height': 65})).encode())
    assert said == 'input.height: expected a whole number, 1 to 64, got 65'


BOMB = b'a: &a [x,x]\n' + b''.join(b'%c: &%c [*%c,*%c]\n' % (i + 1, i + 1, i, i)
                                   for i in range(97, 115))
HOSTILE: list[tuple[bytes, str]] = [
    (b'', 'expected KEY: VALUE pairs with the keys input, scaling, outputs, domain, got None'),
    (b'\xff\xfe\x00', 'is not text in UTF-8'),
    (b'just words',
     "expected KEY: VALUE pairs with the keys input, scaling, outputs, domain, got 'just words'"),
    (b'input: [', 'line 2, column 1: '),
    (b'input: 1\ninput: 2', 'line 2, column 1: input is given twice'),
    (b'input: !!python/object/apply:os.system [ls]', 'could not determine a constructor'),
    (b'? [1, 2]\n: 3', 'line 1, column 3: found unhashable key'),
    (b'\0', 'is not YAML: '),
    (b'a: 2001-99-99', 'is not YAML: '),
    (b'[' * 9000, 'is not YAML: '),
    (b'input: ' + b'9' * 9000, 'is not YAML: '),
    (b'input: 0x' + b'f' * 9000, 'input: expected KEY: VALUE pairs with the keys name, '),
    (b'input: &a [*a]', 'line 1, column 12: an alias (*) is not read; write it out'),
    (BOMB, 'line 2, column 8: an alias (*) is not read; write it out'),
    (b'input: &a [[[[1]]]]', 'got [[[...]]]'),
]


@pytest.mark.parametrize(('data', 'fragment'), HOSTILE)
def test_given_a_file_that_is_no_description_when_read_then_one_line_says_so(
    data: bytes, fragment: str
) -> None:
    assert fragment in complaint(data)


SCALARS = st.booleans() | st.integers() | st.floats() | st.sampled_from(['', 'grey', 'cte', 'm'])
VALUES = SCALARS | st.lists(SCALARS | st.none(), max_size=4)
KEYS = [*REQUIRED, 'input.name', 'input.crop', 'input.brightest', 'scaling.mean', 'scaling.clip',
        'scaling.per_image', 'outputs.1', 'outputs.0.offset']


@given(st.sampled_from(KEYS), VALUES)
def test_given_any_value_when_read_then_a_description_or_one_line(key: str, value: Any) -> None:
    data = yaml.safe_dump(described({key: value})).encode()
    try:
        read = parse_sidecar(FILE, data)
    except UsageError:
        complaint(data)
    else:
        assert len(read.outputs) == 2


@given(st.binary(max_size=40) | st.text('{}[]&*!:-?|>%@,#"\' \nab1', max_size=40).map(str.encode))
def test_given_any_bytes_when_read_then_one_line_says_that_they_are_no_description(
    data: bytes,
) -> None:
    complaint(data)


def test_given_the_manual_when_its_examples_are_read_then_all_are_right() -> None:
    examples = re.findall(r'```yaml\n(.*?)```', MANUAL.read_text(), re.DOTALL)
    assert len(examples) == 2
    large, tiny = (parse_sidecar(FILE, example.encode()) for example in examples)
    assert large.picture.shape == (1, 3, 224, 224)
    assert [output.quantity for output in large.outputs] == ['cte', 'ignore', 'heading_error']
    assert tiny.picture.brightest == Brightest(block=16, keep=16)
