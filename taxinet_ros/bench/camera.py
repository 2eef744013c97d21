"""The camera: a frame of every scene, its stages, and what is made once."""

from __future__ import annotations

import time
from collections.abc import Mapping

from taxinet_ros.bench.measure import Subject
from taxinet_ros.bench.scenes import SCENES, Scene
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.ground import ground_atlas
from taxinet_ros.core.types import NS_PER_S

SUM = 'sum of stages'


def subjects() -> list[Subject]:
    """Frames, whole and by stages, and the making of cameras and textures."""
    ground_atlas()  # as in every process that photographs; what it costs is measured apart
    found = []
    for name, scene in SCENES.items():
        found += _frame(name, scene)
    noon, rain = SCENES['noon'].scenario, SCENES['rain'].scenario
    return [
        *found,
        Subject(name='camera/new, dry', run=lambda: _discard(Camera(noon))),
        Subject(name='camera/new, rain', run=lambda: _discard(Camera(rain))),
        Subject(name='camera/textures', run=_make_textures, warm_ups=0, most=3),
    ]


def _discard(made: object) -> None:
    del made


def _make_textures() -> None:
    """Make what every process makes once."""
    ground_atlas.__wrapped__()


def _frame(name: str, scene: Scene) -> list[Subject]:
    """A frame as a whole, and the stages of another one.

    In a run one camera works all the time; here they take turns. So each sees a frame unmeasured
    before its turn, and its buffers are where they would be.
    """
    camera = Camera(scene.scenario)
    stamp_ns = 0

    def photograph() -> None:
        nonlocal stamp_ns
        stamp_ns += NS_PER_S // 10
        camera.render(scene.state, stamp_ns)

    def stages() -> Mapping[str, int]:
        times: dict[str, int] = {}
        last = time.perf_counter_ns()

        def mark(stage: str) -> None:
            nonlocal last
            now = time.perf_counter_ns()
            times[stage] = now - last
            last = now

        camera.render(scene.state, stamp_ns, mark)
        return {**times, SUM: sum(times.values())}

    whole = f'camera/{name}'
    return [
        Subject(name=whole, run=photograph, before=photograph),
        Subject(name=whole, run=stages, before=photograph),
    ]
