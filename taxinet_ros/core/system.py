"""The system under test: what drives the aircraft in a run, beside the scene."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.pacing.timing import AT_ONCE, NOT_REPRODUCIBLE, Timing
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.world import find_world
from taxinet_ros.registry import KMWH
from taxinet_ros.version import __version__


@dataclass(frozen=True, kw_only=True)
class System:
    """What drives, and in which world; its users add where their bags go.

    Attributes:
        perception: ``truth``, ``taxinet``, a network's file, ``FILE.py:NAME``, or a word of
            :mod:`taxinet_ros.core.user_code`.
        controller: ``steering``, ``FILE.py:NAME``, or a word of :mod:`taxinet_ros.core.user_code`,
            with its monitor and fallback.
        controller_sha256: required hash of the controller's file and the files it lists, so that a
            change during a campaign is detected; '' for any.
        gains: steering gains that differ from the law's defaults, by parameter name.
        timing: when answers take effect.
        world: name of the world that runs take place in, with its camera
            (:mod:`taxinet_ros.core.world`).
        world_sha256: required hash of the package that provides it; '' for any.
    """

    perception: str
    controller: str = STEERING
    controller_sha256: str = ''
    gains: Mapping[str, float] = field(default_factory=dict)
    timing: Timing = AT_ONCE
    world: str = KMWH
    world_sha256: str = ''

    @property
    def digest(self) -> str:
        """Digest of all that decides what it does in a scene; files count by their content.

        Raises:
            UsageError: perception or controller cannot be used.
        """
        return digest_of([
            __version__, check_perception(self.perception), self.controller,
            check_controller(self.controller, self.gains), dict(self.gains), self.timing.words,
            self.world, self.world_sha256,
        ])

    def alone(self, **changes: Any) -> System:
        """The system without what a subclass adds, and with some fields changed."""
        own = {each.name: getattr(self, each.name) for each in dataclasses.fields(System)}
        return System(**{**own, **changes})

    @property
    def not_again(self) -> str:
        """Why its runs cannot be made again; '' if they can.

        Raises:
            UsageError: its world is not here, or is of another package.
        """
        if self.timing.free:
            return NOT_REPRODUCIBLE
        return find_world(self.world, self.world_sha256).again_words


def digest_of(values: Any) -> str:
    """SHA-256 of plain values."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
