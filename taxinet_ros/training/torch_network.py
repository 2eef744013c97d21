"""An architecture as torch trains it."""

from __future__ import annotations

from collections import OrderedDict

from torch import nn

from taxinet_ros.core.network import Architecture


def torch_network(architecture: Architecture) -> nn.Sequential:
    """A network of this architecture, its weights drawn from torch's global generator.

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
