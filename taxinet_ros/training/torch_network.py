"""Torch version of the network for training, with batch normalisation folded in afterwards.

Batch normalisation makes training faster and more accurate (Ioffe and Szegedy, ICML 2015). After
training, each normalisation is an affine map of the preceding convolution and is folded into its
weights, so the shipped network has none.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from taxinet_ros.core.perception.network import Architecture
from taxinet_ros.core.perception.weights import Weights


def torch_network(architecture: Architecture) -> nn.Sequential:
    """A network of this architecture with weights drawn from torch's global generator.

    The names of its layers are those of :meth:`Architecture.shapes`.
    """
    layers: OrderedDict[str, nn.Module] = OrderedDict()
    before = (1, *architecture.channels)
    kernels = zip(architecture.channels, architecture.kernels, strict=True)
    for i, (channels, kernel) in enumerate(kernels):
        layers[f'conv{i}'] = nn.Conv2d(before[i], channels, kernel, 2, kernel // 2)
        layers[f'relu{i}'] = nn.ReLU()
    layers['flatten'] = nn.Flatten()
    features = architecture.shapes()['hidden.weight'][1]
    layers['hidden'] = nn.Linear(features, architecture.hidden)
    layers['relu'] = nn.ReLU()
    layers['output'] = nn.Linear(architecture.hidden, 2)
    return nn.Sequential(layers)


def build_with_batch_norm(architecture: Architecture) -> nn.Sequential:
    """A network for training, with weights drawn from torch's global generator."""
    layers: OrderedDict[str, nn.Module] = OrderedDict()
    for name, layer in torch_network(architecture).named_children():
        layers[name] = layer
        if isinstance(layer, nn.Conv2d):
            layers[_norm_of(name)] = nn.BatchNorm2d(layer.out_channels)
    return nn.Sequential(layers)


def fold_batch_norm(network: nn.Sequential) -> dict[str, NDArray[np.float32]]:
    """Weights of the plain architecture with the same outputs as ``network`` in evaluation."""
    layers = dict(network.named_children())
    weights: dict[str, NDArray[np.float32]] = {}
    for name, layer in layers.items():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            assert layer.bias is not None  # all our layers have one
            weight, bias = layer.weight.detach(), layer.bias.detach()
            norm = layers.get(_norm_of(name))
            if isinstance(norm, nn.BatchNorm2d):
                weight, bias = _folded_layer(weight, bias, norm)
            weights[f'{name}.weight'] = np.array(weight.contiguous().cpu().numpy())
            weights[f'{name}.bias'] = np.array(bias.cpu().numpy())
    return weights


def unfold_batch_norm(network: nn.Sequential, weights: Weights, seen: torch.Tensor) -> None:
    """Load plain weights into a network of :func:`build_with_batch_norm`, to train it further.

    Every normalisation is set to leave its convolution's outputs for ``seen`` unchanged, so that
    evaluation gives the plain network's outputs, and training starts close to them.

    Args:
        network: network to modify.
        weights: weights of its plain architecture.
        seen: some hundred training inputs, (N, 1, H, W).
    """
    network.eval()
    with torch.no_grad():
        for name, layer in network.named_children():
            if isinstance(layer, nn.Conv2d | nn.Linear):
                layer.weight.copy_(torch.from_numpy(weights[f'{name}.weight']))
                assert layer.bias is not None  # all our layers have one
                layer.bias.copy_(torch.from_numpy(weights[f'{name}.bias']))
            elif isinstance(layer, nn.BatchNorm2d):
                _set_to_identity(layer, seen)
            seen = layer(seen)


def _set_to_identity(norm: nn.BatchNorm2d, answers: torch.Tensor) -> None:
    variance, mean = torch.var_mean(answers, dim=(0, 2, 3), correction=0)
    assert norm.running_mean is not None  # both are tracked by default
    assert norm.running_var is not None
    norm.running_mean.copy_(mean)
    norm.running_var.copy_(variance)
    norm.weight.copy_(torch.sqrt(variance + norm.eps))
    norm.bias.copy_(mean)


def _norm_of(convolution: str) -> str:
    return f'{convolution}_norm'


def _folded_layer(
    weight: torch.Tensor, bias: torch.Tensor, norm: nn.BatchNorm2d
) -> tuple[torch.Tensor, torch.Tensor]:
    mean, variance = norm.running_mean, norm.running_var
    assert mean is not None  # both are tracked by default
    assert variance is not None
    scale = norm.weight.detach() / torch.sqrt(variance + norm.eps)
    return weight * scale[:, None, None, None], (bias - mean) * scale + norm.bias.detach()
