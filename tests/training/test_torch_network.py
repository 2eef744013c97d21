from __future__ import annotations

import numpy as np
import torch

from taxinet_ros.core.perception.network import (
    ARCHITECTURES,
    DEFAULT_ARCHITECTURE,
    INPUT_SHAPE,
    TaxiNet,
    normalise,
    unscaled,
)
from taxinet_ros.training.torch_network import (
    build_with_batch_norm,
    fold_batch_norm,
    unfold_batch_norm,
)

ARCHITECTURE = ARCHITECTURES[DEFAULT_ARCHITECTURE]


def test_given_a_trained_norm_when_folded_then_the_plain_network_answers_the_same() -> None:
    pictures = np.random.default_rng(1).integers(0, 256, (8, *INPUT_SHAPE), dtype=np.uint8)
    seen = torch.from_numpy(normalise(pictures))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(2)
        network = build_with_batch_norm(ARCHITECTURE)
        for layer in network:
            if isinstance(layer, torch.nn.BatchNorm2d):
                torch.nn.init.uniform_(layer.weight, 0.5, 2)
                torch.nn.init.normal_(layer.bias)
        network.train()(seen)  # so that the running mean and variance are not 0 and 1
    network.eval()
    with torch.inference_mode():
        expected = unscaled(network(seen).numpy())
    plain = TaxiNet(ARCHITECTURE, fold_batch_norm(network))
    np.testing.assert_allclose(plain.infer(pictures), expected, rtol=1e-3, atol=1e-4)


def test_given_a_normed_network_when_folded_then_names_and_shapes_are_the_architectures() -> None:
    with torch.random.fork_rng(devices=[]):
        shapes = {
            name: array.shape
            for name, array in fold_batch_norm(build_with_batch_norm(ARCHITECTURE)).items()
        }
    assert shapes == ARCHITECTURE.shapes()
    assert list(shapes) == list(ARCHITECTURE.shapes())


def test_given_plain_weights_when_unfolded_and_folded_again_then_the_answers_are_the_same() -> None:
    pictures = np.random.default_rng(3).integers(0, 256, (32, *INPUT_SHAPE), dtype=np.uint8)
    seen = torch.from_numpy(normalise(pictures))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(4)
        plain = fold_batch_norm(build_with_batch_norm(ARCHITECTURE))
        network = build_with_batch_norm(ARCHITECTURE)
    unfold_batch_norm(network, plain, seen)
    expected = TaxiNet(ARCHITECTURE, plain).infer(pictures)
    again = TaxiNet(ARCHITECTURE, fold_batch_norm(network)).infer(pictures)
    np.testing.assert_allclose(again, expected, rtol=1e-3, atol=1e-4)
    # Nor does normalising by the batch, as in training, carry it off.
    with torch.inference_mode():
        in_training = unscaled(network.train()(seen).numpy())
    np.testing.assert_allclose(in_training, expected, rtol=1e-3, atol=1e-4)
