"""What came of shrinking a failed run: for each parameter, whether and from where on it matters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.shrink import Point, State
from taxinet_ros.campaign.shrink_space import Parameter
from taxinet_ros.campaign.shrinking import Shrinking
from taxinet_ros.core.scenario import RAIN_CLOUDS, Scenario


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """What is known of one parameter. Values are in human units; None is what was not run.

    Attributes:
        key: name of the parameter.
        original, nominal, shrunk: its value in the failed run, in plain taxiing, and in the nearest
            scenario to that which still fails.
        rho_in_original, rho_in_shrunk: robustness of either with this parameter made nominal, where
            it is not.
        passes_at: the neighbour of ``shrunk``, one step nearer to nominal, that does not fail.
        rho_passes_at: robustness there.
    """

    key: str
    original: Any
    nominal: Any
    shrunk: Any
    rho_in_original: float | None = None
    rho_in_shrunk: float | None = None
    passes_at: Any = None
    rho_passes_at: float | None = None

    @property
    def matters(self) -> bool:
        """Whether the failure needs it to be other than nominal."""
        return bool(self.shrunk != self.nominal)


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """The whole outcome.

    Attributes:
        state: how far the search has come, and why it ended.
        findings: one for each parameter.
        scenario: the shrunk one.
        original, nominal, shrunk: the runs of the three; None where there is none.
        dry: clouds made nominal take the rain with them, for no rain falls from that sky.
    """

    state: State
    findings: tuple[Finding, ...]
    scenario: Scenario
    original: RunRow | None
    nominal: RunRow | None
    shrunk: RunRow | None
    dry: bool


def report(shrinking: Shrinking) -> Report:
    """What is known by now."""
    space, search = shrinking.options.space, shrinking.search
    state = search.state
    axes = {one.key: number for number, one in enumerate(space.moving)}
    return Report(
        state=state,
        findings=tuple(
            _moved(shrinking, one, axes[one.key], state.at) if one.key in axes
            else Finding(key=one.key, original=one.values[0], nominal=one.values[0],
                         shrunk=one.values[0])
            for one in space.parameters
        ),
        scenario=space.scenario(state.at),
        original=shrinking.row(search.start), nominal=shrinking.row(search.origin),
        shrunk=shrinking.row(state.at),
        dry=space.original.rain > 0 and space.nominal.clouds not in RAIN_CLOUDS,
    )


def _moved(shrinking: Shrinking, one: Parameter, axis: int, at: Point) -> Finding:
    search, steps = shrinking.search, at[axis]
    beside = search.moved(at, axis, max(steps - 1, 0))
    return Finding(
        key=one.key, original=one.values[-1], nominal=one.values[0], shrunk=one.values[steps],
        rho_in_original=search.rho(search.moved(search.start, axis, 0)),
        rho_in_shrunk=search.rho(search.moved(at, axis, 0)) if steps else None,
        passes_at=one.values[steps - 1] if steps and search.rho(beside) is not None else None,
        rho_passes_at=search.rho(beside) if steps else None,
    )
