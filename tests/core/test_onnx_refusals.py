"""Files that are no usable network are refused before a run starts, each in one line."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper
from onnx_samples import linear, model, save

from taxinet_ros.core import onnx_network
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.perception import check_perception, make_perception

Node = helper.make_node
FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64


def complaint(path: Path) -> str:
    """What a check says before a run starts; and making the perception says the same."""
    said = []
    for choose in (check_perception, make_perception):
        with pytest.raises(UsageError) as caught:
            choose(str(path))
        said.append(str(caught.value))
    assert said[0] == said[1]
    assert '\n' not in said[0]
    assert said[0].startswith(f'onnx: {path.parent}/net.')
    return said[0].removeprefix(f'onnx: {path.parent}/')


WHOLE = linear().SerializeToString()
NAMED = linear(shape=('side', 1, 4, 6)).SerializeToString()
BROKEN = [
    (b'', 'net.onnx: is empty; copy it again'),
    (b'version https://git-lfs.github.com/spec/v1', 'git lfs pull'),
    (b'\0' * 200, 'net.onnx: is no model that onnxruntime '),
    (b'PK\3\4 a torch file', 'net.onnx: is no model that onnxruntime '),
    (b'ORTM' + b'\0' * 100, 'net.onnx: is no model that onnxruntime '),
    (b'// Neural Network File Format', 'net.onnx: is no model that onnxruntime '),
    (WHOLE[:-7], 'net.onnx: is no model that onnxruntime '),
    (WHOLE[: len(WHOLE) // 2], 'net.onnx: is no model that onnxruntime '),
    (NAMED.replace(b'side', b'\xfe\xff\xff\xff'), 'net.onnx: is no model that onnxruntime '),
    (WHOLE.replace(b'weights', b'\xff\xff\xff\xff\xff\xff\xff', 1), 'net.onnx: is no model that '),
    (WHOLE + b'rest', 'net.onnx: is no model that onnxruntime '),
]


@pytest.mark.parametrize(('data', 'fragment'), BROKEN)
def test_given_a_file_that_is_no_model_when_checked_then_one_line_and_no_more(
    data: bytes, fragment: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert fragment in complaint(save(tmp_path, data))
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize('suffix', ['.onnx', '.yaml'])
def test_given_a_file_that_cannot_be_read_when_checked_then_one_line(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path)
    file = path.with_suffix(suffix)
    with monkeypatch.context() as patched:
        read = Path.read_bytes

        def deny(self: Path) -> bytes:
            if self == file:
                raise PermissionError(13, 'Permission denied')
            return read(self)

        patched.setattr(Path, 'read_bytes', deny)
        assert complaint(path) == f'net{suffix}: cannot be read (Permission denied)'
    os.truncate(file, (256 << 20) + 1)
    assert complaint(path).startswith(f'net{suffix}: has more than ')
    file.unlink()
    assert complaint(path).startswith(f'net{suffix}: no such file')
    file.mkdir()
    assert complaint(path) == f'net{suffix}: is no file; name the file itself'


def test_given_no_description_when_checked_then_the_manual_is_named(tmp_path: Path) -> None:
    path = save(tmp_path)
    path.with_suffix('.yaml').unlink()
    assert 'needs its description beside it, see docs/onnx.md' in complaint(path)


@pytest.mark.parametrize('location', ['weights.bin', '../weights.bin', '/{}/weights.bin'])
def test_given_weights_in_a_further_file_when_checked_then_it_is_not_read(
    location: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / 'net'
    folder.mkdir()
    network = linear()
    tensor = network.graph.initializer[0]
    for place in (tmp_path, folder):
        (place / 'weights.bin').write_bytes(tensor.raw_data)
    tensor.ClearField('raw_data')
    tensor.data_location = TensorProto.EXTERNAL
    tensor.external_data.add(key='location', value=location.format(tmp_path))
    monkeypatch.chdir(folder)
    said = complaint(save(folder, network))
    assert said == ('net.onnx: keeps weights in further files, which are not read; export it in '
                    'one file')


IDENTITY = [Node('Flatten', ['picture'], ['answer'])]
TWO = model([Node('Add', ['picture', 'other'], ['answer'])], inputs=('picture', 'other'))
WHOLE_NUMBERS = model([Node('Flatten', ['picture'], ['answer'])], kind=INT64,
                      outputs={'answer': INT64})
CLASSES = model(
    [Node('Flatten', ['picture'], ['flat']), Node('ArgMax', ['flat'], ['answer'], axis=1)],
    outputs={'answer': INT64})
DISAGREEING: list[tuple[onnx.ModelProto, dict[str, Any], str]] = [
    (TWO, {}, 'net.onnx: has 2 inputs; a network that sees has one'),
    (WHOLE_NUMBERS, {}, "net.onnx: input 'picture' is tensor(int64); export the network with"),
    (CLASSES, {}, "net.onnx: output 'answer' is tensor(int64); export the network with outputs of"),
    (linear(), {'input.name': 'image'}, "input.name is 'image', but the model's input is "),
    (linear(), {'input.layout': 'nhwc'}, "say (1, 4, 6, 1), but the model's input 'picture' is"),
    (linear(), {'input.layout': 'flat'}, "say (1, 24), but the model's input 'picture' is (?,"),
    (linear(), {'input.colour': 'rgb'}, "say (1, 3, 4, 6), but the model's input 'picture' is (?"),
    (linear(), {'input.height': 5}, "say (1, 1, 5, 6), but the model's input 'picture' is (?,"),
    (linear(shape=(8, 1, 4, 6)), {}, "but the model's input 'picture' is (8, 1, 4, 6); mend the"),
    (linear((1, 2, 3)), {}, 'outputs has 2 entries, but the model gives 3 numbers; mend the'),
    (model(IDENTITY), {}, 'net.yaml: outputs has 2 entries, but the model gives 24 numbers'),
    (linear(shape=(None,) * 4), {'input.height': 5}, 'net.onnx: fails on a grey frame ('),
    (linear((math.nan, 0)), {}, 'net.onnx: answers a grey frame with numbers that are not finite'),
    (linear((0, math.inf)), {}, 'net.onnx: answers a grey frame with numbers that are not finite'),
]


@pytest.mark.parametrize(('network', 'changes', 'fragment'), DISAGREEING)
def test_given_files_that_do_not_agree_when_checked_then_one_line_says_where(
    network: onnx.ModelProto, changes: dict[str, Any], fragment: str, tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert fragment in complaint(save(tmp_path, network, changes))
    assert capfd.readouterr() == ('', '')


def test_given_a_network_that_rolls_dice_when_checked_then_it_is_refused(tmp_path: Path) -> None:
    network = linear()
    network.graph.node[1].output[0] = 'sure'
    network.graph.node.extend([
        Node('RandomNormalLike', ['sure'], ['dice'], seed=1.0),
        Node('Add', ['sure', 'dice'], ['answer']),
    ])
    assert 'answers the same frame differently each time' in complaint(save(tmp_path, network))


def test_given_a_network_without_end_when_checked_then_it_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(onnx_network, 'TRIAL_LIMIT_S', 0.2)
    value = helper.make_tensor_value_info
    body = helper.make_graph(
        [Node('Identity', ['go'], ['on']), Node('Identity', ['x'], ['y'])], 'body',
        [value('i', INT64, []), value('go', TensorProto.BOOL, []), value('x', FLOAT, None)],
        [value('on', TensorProto.BOOL, []), value('y', FLOAT, None)],
    )
    network = model([Node('Loop', ['', 'yes', 'picture'], ['answer'], body=body)],
                    {'yes': np.array(True)})
    assert 'net.onnx: fails on a grey frame (' in complaint(save(tmp_path, network))
