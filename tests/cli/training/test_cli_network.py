"""``taxinet network``: a network of others is converted and shown; nothing is overwritten."""

import pytest
from nnet_samples import TINY, sample

FROM_NNET = ('network', 'from-nnet', 'net.nnet', '--description')


def test_given_a_network_then_it_is_converted_beside_its_description_and_sees_a_scene(
    taxinet, tmp_path
):
    (tmp_path / 'net.nnet').write_text(sample(TINY, plain=True).text())
    code, out, err = taxinet(*FROM_NNET, 'tinytaxinet', '--out', 'net.onnx')
    assert (code, err) == (0, '')
    assert 'net.nnet: 128 inputs, 16, 8, 8 hidden neurons, 2 outputs; SHA-256' in out
    assert 'written: net.onnx, net.yaml (description: tinytaxinet)' in out
    seen = taxinet('network', 'see', 'net.onnx', '--set', 'cross_track=3', '--out', 'p.png')
    code, out, err = seen
    assert (code, err) == (0, '')
    assert 'truth CTE +3.00 m, HE +0.0 deg' in out
    assert (tmp_path / 'p.png').read_bytes().startswith(b'\x89PNG')
    before = (tmp_path / 'net.onnx').read_bytes()
    code, _, err = taxinet(*FROM_NNET, 'tinytaxinet', '--out', 'net.onnx')
    assert (code, 'net.onnx: already exists' in err) == (2, True)
    assert (tmp_path / 'net.onnx').read_bytes() == before
    code, out, err = taxinet(*FROM_NNET, 'net.yaml', '--out', 'again.onnx')
    assert (code, err) == (0, '')
    assert (tmp_path / 'again.onnx').read_bytes() == before


@pytest.mark.parametrize(('words', 'told'), [
    (('tinytaxinet', '--out', 'net.bin'), '--out net.bin: networks are .onnx files'),
    (('tinytaxinet', '--out', 'no/net.onnx'), 'no such folder: no'),
    (('tiny', '--out', 'net.onnx'), 'description tiny: neither tinytaxinet nor a readable file'),
    (('tinytaxinet', '--out', 'net.onnx'), 'nnet: net.nnet: cannot be read'),
])
def test_given_a_mistake_then_one_line_and_nothing_is_written(words, told, taxinet, tmp_path):
    code, _, err = taxinet(*FROM_NNET, *words)
    assert (code, told in err, err.count('\n')) == (2, True, 1), err
    assert list(tmp_path.iterdir()) == []
