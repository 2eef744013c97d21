"""The shipped network: reducing a frame, and looking at it."""

from __future__ import annotations

from taxinet_ros.bench.measure import Subject
from taxinet_ros.bench.scenes import SCENES
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.network import ARCHITECTURES, TaxiNet, shrink
from taxinet_ros.core.perception import make_perception
from taxinet_ros.core.weights import SHIPPED, load_model


def subjects() -> list[Subject]:
    """One estimate, and its two halves.

    Raises:
        UsageError: the shipped weights cannot be used.
    """
    scene = SCENES['noon']
    image = Camera(scene.scenario).render(scene.state, 0)
    perception = make_perception('taxinet')
    model = load_model(SHIPPED['taxinet'])
    network = TaxiNet(ARCHITECTURES[model.card.architecture], model.weights)
    reduced = shrink(image)[None]

    def estimate() -> None:
        perception.estimate(image, None)

    def reduce() -> None:
        shrink(image)

    def look() -> None:
        network.infer(reduced)

    return [
        Subject(name='inference/estimate', run=estimate, before=estimate),
        Subject(name='inference/preprocessing', run=reduce, before=reduce),
        Subject(name='inference/network', run=look, before=look),
    ]
