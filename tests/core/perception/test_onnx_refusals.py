"""Files that are no usable network are refused before a run starts, each in one line."""

from __future__ import annotations

import itertools
import math
import os
import re
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray
from onnx import NodeProto, TensorProto, helper
from onnx_samples import linear, model, save

from taxinet_ros.core.perception.onnx import trial as onnx_trial
from taxinet_ros.core.perception.onnx.network import NetworkFiles, OnnxNetwork, trial_frames
from taxinet_ros.core.perception.onnx.trial import inspect
from taxinet_ros.core.perception.perception import check_perception, make_perception
from taxinet_ros.errors import InfraError, UsageError

Node = helper.make_node
FLOAT, INT64 = TensorProto.FLOAT, TensorProto.INT64


def complaint(path: Path, look: Callable[[Path], object] | None = None) -> str:
    """What is said of a network, by default by what looks at it in the process with limits."""
    with pytest.raises(UsageError) as caught:
        (look or (lambda path: inspect(NetworkFiles.read(path))))(path)
    said = str(caught.value)
    assert '\n' not in said
    assert said.startswith(f'onnx: {path.parent}/net.')
    return said.removeprefix(f'onnx: {path.parent}/')


def told(path: Path) -> str:
    """What a check says before a run starts, by way of a process; and making the perception."""
    checked, made = (
        complaint(path, lambda path, choose=choose: choose(str(path)))
        for choose in (check_perception, make_perception)
    )
    assert checked == made
    return made


@pytest.fixture(autouse=True)
def nothing_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_trial, '_sound', set())


WHOLE = linear().SerializeToString()
NAMED = linear(shape=('side', 1, 4, 6)).SerializeToString()
BROKEN = [
    (b'', 'net.onnx: is empty; copy it again'),
    (b'version https://git-lfs.github.com/spec/v1', 'git lfs pull'),
    (b'\0' * 200, 'net.onnx: is not a model that onnxruntime '),
    (b'PK\3\4 a torch file', 'net.onnx: is not a model that onnxruntime '),
    (b'ORTM' + b'\0' * 100, 'net.onnx: is not a model that onnxruntime '),
    (b'// Neural Network File Format', 'net.onnx: is not a model that onnxruntime '),
    (WHOLE[:-7], 'net.onnx: is not a model that onnxruntime '),
    (WHOLE[: len(WHOLE) // 2], 'net.onnx: is not a model that onnxruntime '),
    (NAMED.replace(b'side', b'\xfe\xff\xff\xff'), 'net.onnx: is not a model that onnxruntime '),
    (WHOLE.replace(b'weights', b'\xff\xff\xff\xff\xff\xff\xff', 1), 'net.onnx: is not a model'),
    (WHOLE + b'rest', 'net.onnx: is not a model that onnxruntime '),
]


@pytest.mark.parametrize(('data', 'fragment'), BROKEN)
def test_given_a_file_that_is_no_model_when_checked_then_one_line_and_no_more(
    data: bytes, fragment: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert fragment in complaint(save(tmp_path, data))
    assert capfd.readouterr() == ('', '')


def stamped(**versions: int) -> bytes:
    network = linear()
    network.ir_version = versions.get('ir', network.ir_version)
    network.opset_import[0].version = versions.get('opset', network.opset_import[0].version)
    return network.SerializeToString()


@pytest.mark.parametrize(('data', 'said'), [
    (stamped(ir=99), r'\(IR version 99; it knows those up to (\d+)\); export it with IR version \1 '
                     'or older'),
    (stamped(opset=99), r'\(opset 99; it knows those up to (\d+)\); export it with opset \1 or '
                        'older'),
    (model([Node('Nope', ['picture'], ['answer'])]).SerializeToString(),
     r'\(No Op registered for Nope with domain_version of 17\); copy or export it again'),
])
def test_a_model_that_onnxruntime_cannot_run_is_refused_with_its_reason_in_front(
    data: bytes, said: str, tmp_path: Path,
) -> None:
    answer = complaint(save(tmp_path, data))
    assert re.fullmatch(rf'net.onnx: is not a model that onnxruntime [\d.]+ can run {said}', answer)


def test_an_input_without_a_shape_runs_as_with_one_or_says_why_not(tmp_path: Path) -> None:
    answers = []
    for name, shape in (('with', ('N', 1, 4, 6)), ('without', None)):
        (tmp_path / name).mkdir()
        path = save(tmp_path / name, linear(shape=shape).SerializeToString())
        network = OnnxNetwork(NetworkFiles.read(path))
        answers.append([network.look(frame) for frame in trial_frames().values()])
        inspect(NetworkFiles.read(path))
    assert np.isfinite(answers).all()
    assert answers[0] == answers[1]
    unfit = linear(pixels=25, shape=None).SerializeToString()
    assert 'net.onnx: fails on a grey frame (' in complaint(save(tmp_path, unfit))


@pytest.mark.parametrize('suffix', ['.onnx', '.yaml'])
def test_given_a_file_that_cannot_be_read_when_checked_then_one_line(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path)
    file = path.with_suffix(suffix)
    with monkeypatch.context() as patched:
        opened = Path.open

        def deny(self: Path, *words: Any) -> Any:
            if self == file:
                raise PermissionError(13, 'Permission denied')
            return opened(self, *words)

        patched.setattr(Path, 'open', deny)
        assert complaint(path) == f'net{suffix}: cannot be read (Permission denied)'
    os.truncate(file, (256 << 20) + 1)
    assert complaint(path).startswith(f'net{suffix}: has more than ')
    file.unlink()
    assert complaint(path).startswith(f'net{suffix}: no such file')
    file.mkdir()
    assert complaint(path) == f'net{suffix}: is not a file; name the file itself'


def test_given_no_description_when_checked_then_the_manual_is_named(tmp_path: Path) -> None:
    path = save(tmp_path)
    path.with_suffix('.yaml').unlink()
    assert 'description beside it, which network describe writes, see docs/onnx' in complaint(path)


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
    (linear(shape=(8, 1, 4, 6)), {}, "but the model's input 'picture' is (8, 1, 4, 6); correct"),
    (linear((1, 2, 3)), {}, 'outputs has 2 entries, but the model gives 3 numbers; correct the'),
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


def gated(*dice: NodeProto) -> onnx.ModelProto:
    """A network to which is added what ``dice`` makes of ``like``, in bright frames only."""
    network = linear()
    network.graph.node[1].output[0] = 'sure'
    network.graph.initializer.extend([
        onnx.numpy_helper.from_array(np.array(value, np.float32), name)
        for name, value in (('limit', 0.95), ('like', np.zeros((1, 2))))
    ])
    network.graph.node.extend([
        Node('ReduceMean', ['picture'], ['mean'], axes=[1, 2, 3], keepdims=0),
        Node('Greater', ['mean', 'limit'], ['bright']), *dice,
        Node('Where', ['bright', 'drawn', 'like'], ['more']),
        Node('Add', ['sure', 'more'], ['answer']),
    ])
    return network


def graph(nodes: list[NodeProto]) -> onnx.GraphProto:
    return helper.make_graph(
        nodes, 'branch', [], [helper.make_tensor_value_info('inner', FLOAT, None)])


def within_a_branch() -> onnx.ModelProto:
    network = gated()
    dice, none = (graph([Node(word, ['like'], ['inner'])])
                  for word in ('RandomNormalLike', 'Identity'))
    choice = Node('If', ['bright'], ['drawn'], then_branch=dice, else_branch=none)
    network.graph.node.insert(4, choice)
    return network


def within_a_function() -> onnx.ModelProto:
    network = gated(Node('Chance', ['like'], ['drawn'], domain='own'))
    network.functions.append(helper.make_function(
        'own', 'Chance', ['x'], ['y'], [Node('RandomUniformLike', ['x'], ['y'])],
        [helper.make_opsetid('', 17)],
    ))
    network.opset_import.append(helper.make_opsetid('own', 1))
    return network


def trained() -> onnx.ModelProto:
    network = gated(Node('Dropout', ['ones', 'ratio', 'yes'], ['drawn']))
    for name, value in (('ones', np.ones((1, 2), np.float32)), ('ratio', np.float32(0.5)),
                        ('yes', np.array(True))):
        network.graph.initializer.append(onnx.numpy_helper.from_array(np.asarray(value), name))
    return network


DICE = {
    'RandomNormalLike': gated(Node('RandomNormalLike', ['like'], ['drawn'], seed=1.0)),
    'RandomUniformLike': gated(Node('RandomUniformLike', ['like'], ['drawn'])),
    'RandomNormal': gated(Node('RandomNormal', [], ['drawn'], shape=[1, 2])),
    'RandomUniform': gated(Node('RandomUniform', [], ['drawn'], shape=[1, 2], seed=3.0)),
    'Multinomial': gated(
        Node('Multinomial', ['like'], ['drawn32'], sample_size=2),
        Node('Cast', ['drawn32'], ['drawn'], to=FLOAT)),
    'Bernoulli': gated(Node('Bernoulli', ['like'], ['drawn'])),
    'Dropout': trained(),
    'RandomNormalLike in a branch': within_a_branch(),
    'RandomUniformLike in a function': within_a_function(),
}


@pytest.mark.parametrize('name', DICE)
def test_f8_given_a_network_that_rolls_dice_for_some_frames_then_the_layer_is_named(
    name: str, tmp_path: Path
) -> None:
    path = save(tmp_path, DICE[name])
    OnnxNetwork(NetworkFiles.read(path))  # the runtime takes it
    assert complaint(path) == (
        f'net.onnx: has a random layer, {name.split()[0]}; export it for inference, '
        'without random layers')


def test_f8_given_a_dropout_of_inference_then_it_is_no_dice(tmp_path: Path) -> None:
    network = gated(Node('Dropout', ['like'], ['drawn']))
    assert inspect(NetworkFiles.read(save(tmp_path, network)))


@pytest.mark.parametrize('frame', trial_frames())
def test_f8_given_other_answers_the_second_time_then_they_are_noticed_on_every_kind_of_frame(
    frame: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path)
    assert inspect(NetworkFiles.read(path))
    look, odd, calls = OnnxNetwork._run, trial_frames()[frame], itertools.count()

    def unsure(self: OnnxNetwork, image: NDArray[np.uint8]) -> NDArray[np.float64]:
        return look(self, image) + (next(calls) * 1e-9 if np.array_equal(image, odd) else 0.0)

    monkeypatch.setattr(OnnxNetwork, '_run', unsure)
    assert 'answers the same frame differently each time' in complaint(path)


def test_f8_given_other_answers_in_another_process_then_they_are_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path)
    look = OnnxNetwork._run
    monkeypatch.setattr(OnnxNetwork, '_run', lambda self, image: look(self, image) + 1e-9)
    assert 'answers the same frame differently each time' in told(path)


HUGE = np.array([1_630_000_000])  # 6.5 GB
LARGE = np.array([3000, 3000])


def constant(side: NDArray[np.int64], *nodes: NodeProto) -> onnx.ModelProto:
    """A network of some hundred bytes with a large constant, which opening it computes."""
    network = linear()
    network.graph.node[1].output[0] = 'sure'
    one = helper.make_tensor('value', FLOAT, [1], [1e-4])
    network.graph.initializer.append(onnx.numpy_helper.from_array(side, 'side'))
    network.graph.node.extend([
        Node('ConstantOfShape', ['side'], ['m0'], value=one), *nodes,
        Node('ReduceMax', [f'm{len(nodes)}'], ['more'], keepdims=0),
        Node('Add', ['sure', 'more'], ['answer']),
    ])
    return network


def looped() -> onnx.ModelProto:
    value = helper.make_tensor_value_info
    body = helper.make_graph(
        [Node('Identity', ['go'], ['on']), Node('Identity', ['x'], ['y'])], 'body',
        [value('i', INT64, []), value('go', TensorProto.BOOL, []), value('x', FLOAT, None)],
        [value('on', TensorProto.BOOL, []), value('y', FLOAT, None)],
    )
    return model([Node('Loop', ['', 'yes', 'picture'], ['answer'], body=body)],
                 {'yes': np.array(True)})


MULTIPLIED = constant(LARGE, *(Node('MatMul', [f'm{i}'] * 2, [f'm{i + 1}']) for i in range(60)))


@pytest.mark.nightly
@pytest.mark.parametrize(('network', 'fragment'), [
    (constant(HUGE), 'net.onnx: needs more memory than allowed for a network, 2 GiB'),
    (MULTIPLIED, 'net.onnx: needs more than 2 s of processor time to be opened'),
    (looped(), 'net.onnx: needs more than 2 s of processor time to be opened'),
], ids=['constants', 'products', 'loop'])
def test_f8_given_a_network_without_measure_when_chosen_then_it_takes_nothing_here(
    network: onnx.ModelProto, fragment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(onnx_trial, 'CPU_S', 2)
    path = save(tmp_path, network)
    assert path.stat().st_size < 3000
    before = resource.getrusage(resource.RUSAGE_SELF)
    assert complaint(path, lambda path: make_perception(str(path))).startswith(fragment)
    after = resource.getrusage(resource.RUSAGE_SELF)
    assert after.ru_utime - before.ru_utime < 1.0
    assert after.ru_maxrss - before.ru_maxrss < 100 << 10, '[KiB]'
    assert capfd.readouterr() == ('', '')


@pytest.mark.parametrize(('number', 'error', 'words'), [
    (signal.SIGKILL, InfraError, 'killed by SIGKILL'),
    (signal.SIGSEGV, UsageError, 'crashes its trial process (killed by SIGSEGV)'),
    (signal.SIGXCPU, UsageError, 'needs more than 30 s of processor time'),
])
def test_f8_given_a_trial_that_is_killed_then_it_is_told_whose_fault_that_is(
    number: int, error: type[Exception], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    killed = tmp_path / 'killed'
    killed.write_text(f'#!/bin/sh\nkill -{int(number)} $$\n')
    killed.chmod(0o755)
    monkeypatch.setattr(sys, 'executable', str(killed))
    with pytest.raises(error, match=re.escape(words)):
        make_perception(str(save(tmp_path)))


def test_f8_given_a_file_that_changes_while_it_is_tried_then_it_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path)
    old = NetworkFiles.read(path)
    save(tmp_path, linear((0.5, 0.5)))
    monkeypatch.setattr(NetworkFiles, 'read', lambda path: old)
    assert told(path).startswith('net.onnx: was changed during the check')


def test_f8_given_a_network_that_was_tried_when_made_again_then_no_other_process_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path)
    fingerprint = check_perception(str(path))
    monkeypatch.setattr(sys, 'executable', '/nowhere/python')
    assert make_perception(str(path)).fingerprint == fingerprint
