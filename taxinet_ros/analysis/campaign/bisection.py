"""Which of several networks in order broke which scenes, scene by scene.

A scene that the first network satisfies and the last one violates has a place in the order at which
it breaks: a network that satisfies it beside one that violates it. Bisection finds such a place in
about log2(N) runs. If a scene breaks, is fixed and breaks again, there are several; bisection
finds one of them, and running every network finds all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.core.provenance import provenance
from taxinet_ros.files.plain_values import plain

Drive = Callable[[int, Sequence[str]], Mapping[str, bool | None]]
"""Runs the network at a place of the order in some scenes: whether each is satisfied, or None."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BisectedScene:
    """One scene.

    Attributes:
        name: its name.
        results: whether it is satisfied by place of the network, as far as run; None: not judged.
        broken: places of the networks that violate it after one that satisfies it.
        fixed: places of the networks that satisfy it after one that violates it.
    """

    name: str
    results: Mapping[int, bool | None]
    broken: tuple[int, ...]
    fixed: tuple[int, ...]

    @property
    def unclear(self) -> bool:
        """Whether a run that was needed could not be judged."""
        return None in self.results.values()


@dataclass(frozen=True, kw_only=True)
class Bisection:
    """All scenes.

    Attributes:
        networks: words or files in order.
        every: whether every network was run in every scene.
        scenes: the scenes, in their order.
        runs: number of results that were needed.
    """

    networks: tuple[str, ...]
    every: bool
    scenes: tuple[BisectedScene, ...]
    runs: int

    def broken_by(self, place: int) -> tuple[str, ...]:
        """Names of the scenes that a network broke."""
        return tuple(scene.name for scene in self.scenes if place in scene.broken)

    def fixed_by(self, place: int) -> tuple[str, ...]:
        """Names of the scenes that a network fixed."""
        return tuple(scene.name for scene in self.scenes if place in scene.fixed)


def bisect_scenes(
    networks: Sequence[str], scenes: Sequence[str], drive: Drive, *, every: bool = False
) -> Bisection:
    """Find where each scene breaks.

    Args:
        networks: words or files in order, two or more, the good one first.
        scenes: names of the scenes.
        drive: runs a network in some scenes; called with each pair at most once.
        every: run every network in every scene.
    """
    last = len(networks) - 1
    results: dict[str, dict[int, bool | None]] = {name: {} for name in scenes}

    def run(place: int, names: Sequence[str]) -> None:
        waiting = [name for name in names if place not in results[name]]
        if waiting:
            for name, passed in drive(place, waiting).items():
                results[name][place] = passed

    for place in range(len(networks)) if every else (0, last):
        run(place, scenes)
    spans = {
        name: (0, last) for name in scenes
        if not every and results[name][0] is True and results[name][last] is False
    }
    while spans := {name: span for name, span in spans.items() if span[1] - span[0] > 1}:
        middles = {name: (low + high) // 2 for name, (low, high) in spans.items()}
        for place in sorted(set(middles.values())):
            run(place, [name for name, middle in middles.items() if middle == place])
        for name, middle in middles.items():
            low, high = spans[name]
            passed = results[name][middle]
            # A run without a verdict says on neither side where it broke.
            spans[name] = (
                (high, high) if passed is None else (middle, high) if passed else (low, middle)
            )
    return Bisection(
        networks=tuple(networks), every=every, runs=sum(map(len, results.values())),
        scenes=tuple(_scene(name, results[name]) for name in scenes),
    )


def _scene(name: str, results: Mapping[int, bool | None]) -> BisectedScene:
    beside = [(place, results[place - 1], results[place]) for place in sorted(results)
              if place - 1 in results]
    return BisectedScene(
        name=name, results=dict(sorted(results.items())),
        broken=tuple(place for place, was, now in beside if was is True and now is False),
        fixed=tuple(place for place, was, now in beside if was is False and now is True),
    )


def bisection_text(found: Bisection) -> str:
    """The findings as text."""
    return macro_text(Path(__file__).with_suffix('.j2'), 'found', f=found)


def bisection_json(found: Bisection) -> dict[str, Any]:
    """Everything as plain values."""
    return plain({
        'networks': list(found.networks), 'every': found.every, 'runs': found.runs,
        'broken': {
            found.networks[place]: list(found.broken_by(place))
            for place in range(1, len(found.networks))
        },
        'fixed': {
            found.networks[place]: list(found.fixed_by(place))
            for place in range(1, len(found.networks))
        },
        'scenes': {
            scene.name: {
                found.networks[place]: passed for place, passed in scene.results.items()
            } for scene in found.scenes
        },
        'made_on': dict(provenance()),
    })
