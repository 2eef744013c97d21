"""Parts of a run, each alone in this process: making cameras, network, physics, samplers."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from functools import partial

from taxinet_ros import registry
from taxinet_ros.bench.measure import Subject
from taxinet_ros.bench.subjects import SCENES
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.camera.ground.atlas import ground_atlas, make_ground_atlas
from taxinet_ros.core.camera.ground.pavement import standard_style
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.perception.network import ARCHITECTURES, TaxiNet, shrink
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.perception.weights import SHIPPED, load_model
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.types import NS_PER_S, TaxiCommand
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.sampler import Lagged
from taxinet_ros.samplers.space import Dimension, Point


def camera_subjects() -> list[Subject]:
    """The making of cameras, of a lens with faults that no other one has, and of textures."""
    runway = default_runway()
    ground_atlas(runway)  # loaded in every process that renders; its cost is measured separately
    noon, rain = SCENES['noon'].scenario, SCENES['rain'].scenario
    return [
        Subject(name='camera/new, dry', run=lambda: _discard(Camera(noon))),
        Subject(name='camera/new, rain', run=lambda: _discard(Camera(rain))),
        Subject(name='camera/new, lens faults', run=partial(_new_lens, itertools.count())),
        Subject(name='camera/textures', run=_make_textures, warm_ups=0, most=3),
        Subject(name='camera/textures, taxiway', run=_make_taxiway, warm_ups=0, most=3),
    ]


def _new_lens(seeds: Iterator[int]) -> None:
    """A camera whose spots no other one has drawn before."""
    seed = float(next(seeds))
    Camera(dataclasses.replace(SCENES['lens-faults'].scenario, fault_seed=seed))


def _discard(made: object) -> None:
    del made


def _make_textures() -> None:
    """Make the textures that every process makes once."""
    runway = default_runway()
    make_ground_atlas(standard_style(runway), runway)


def _make_taxiway() -> None:
    """Make what the first run along a track makes in a process."""
    runway = default_runway()
    make_ground_atlas(standard_style(runway), runway, SCENES['taxiway'].scenario.line)


def inference_subjects() -> list[Subject]:
    """One estimate, and its two halves: preprocessing and inference.

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


_PHYSICS_STEPS = 20


_PUSHED = {
    '': Scenario(),
    ', wind': Scenario(wind_speed_mps=5.0),
    ', gusts': Scenario(wind_speed_mps=5.0, gust_mps=1.5),
    ', wet, uphill': Scenario(runway_state='wet', slope_fraction=0.02),
}
"""Scenarios by the end of the subject's name: what moves the aircraft besides the controller."""


def physics_subjects() -> list[Subject]:
    """Twelve physics steps make one control step."""
    return [
        *(
            Subject(
                name=f'physics/control step{words}', run=partial(_advance, Aircraft(scenario)),
                calls=_PHYSICS_STEPS, simulated_s=CONTROL_PERIOD_NS / NS_PER_S,
            )
            for words, scenario in _PUSHED.items()
        ),
        *(
            Subject(name=f'physics/new{words}', run=partial(_make, scenario), most=20)
            for words, scenario in _PUSHED.items()
        ),
    ]


def _advance(aircraft: Aircraft) -> None:
    command = TaxiCommand(steering_rad=0.0, speed_mps=5.0)
    for _ in range(_PHYSICS_STEPS):
        aircraft.advance(command)


def _make(scenario: Scenario) -> None:
    Aircraft(scenario)


SAMPLER_SPACE = (
    *(Dimension(name=f'continuous {number}') for number in range(5)),
    Dimension(name='clouds', weights=(1.0,) * 6),
    Dimension(name='rain', weights=(2.0, 1.0)),
)
"""Seven dimensions, as many as the shipped programs vary; two of them are categories."""
SAMPLER_RUNS = 120
"""Runs made before the first one measured."""
_SAMPLER_CALLS = {'tpe': 5, 'cmaes': 5, 'bo': 1}
_USUAL_CALLS = 50


def sampler_subjects() -> list[Subject]:
    """Asking each sampler for a run and telling it the result."""
    return [
        Subject(
            name=f'samplers/{word}',
            run=_first_filled(word),
            calls=_SAMPLER_CALLS.get(word, _USUAL_CALLS),
            warm_ups=1,
            most=3 if word == 'bo' else 20,
        )
        for word in registry.SHIPPED[registry.SAMPLERS]
    ]


def _first_filled(word: str) -> Callable[[], None]:
    """Runs of a sampler that has already made :data:`SAMPLER_RUNS`."""
    # A Gaussian process costs nothing before it starts; then its window is full at once.
    options = {'startup': SAMPLER_RUNS} if word == 'bo' else {}
    sampler = make_sampler(word, SAMPLER_SPACE, 0, SAMPLER_RUNS, **options)
    _make_runs(sampler, SAMPLER_RUNS + 10)
    return partial(_make_runs, sampler, _SAMPLER_CALLS.get(word, _USUAL_CALLS))


def _make_runs(sampler: Lagged, number: int) -> None:
    for _ in range(number):
        index, point = sampler.next()
        sampler.tell(index, _robustness(point))


def _robustness(point: Point) -> float:
    """Bowl-shaped robustness with which about one run in ten fails."""
    return sum((quantile - 0.3) ** 2 for quantile in point if quantile is not None) - 0.4
