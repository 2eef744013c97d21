"""Camera frames of a run for its viewer: every half second, small, recorded or rendered again."""

from __future__ import annotations

import base64
import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.resimulate import observations
from taxinet_ros.bag.trace import read_images
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import InfraError, UsageError

STEPS_APART = 5
"""Every fifth control step has a frame on the page: two to a second."""

MOST_FRAMES = 120
"""Longer runs than a minute have theirs farther apart, to keep the page small."""

_QUALITY = 70
"""Of WebP: stripes stay sharp, and a frame has about 4 kB."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Frames:
    """What the camera saw.

    Attributes:
        steps: row of the trace that each frame belongs to, ascending.
        files: a WebP file for each.
        missing: why there are fewer than wanted, or ''.
    """

    steps: tuple[int, ...]
    files: tuple[bytes, ...]
    missing: str

    def data(self) -> dict[str, Any]:
        """All of it as JSON values."""
        return {
            'steps': list(self.steps), 'missing': self.missing,
            'webp': [base64.b64encode(file).decode('ascii') for file in self.files],
        }


def read_frames(bag: Path, stamps_ns: Sequence[int]) -> Frames:
    """Frames of some of a run's control steps, as recorded, else rendered now.

    Args:
        bag: a run folder or an ``.mcap`` file.
        stamps_ns: simulated time of each row of the trace.

    Raises:
        BagError: a recorded frame is damaged.
    """
    apart = max(STEPS_APART, math.ceil(len(stamps_ns) / MOST_FRAMES))
    wanted = {stamp: row for row, stamp in enumerate(stamps_ns) if row % apart == 0}
    files = {
        wanted[stamp]: _webp(pixels) for stamp, pixels in read_images(bag) if stamp in wanted
    }
    lacking = {stamp: row for stamp, row in wanted.items() if row not in files}
    missing = ''
    if lacking:
        try:
            for stamp, pixels in _rendered(bag, lacking):
                files[lacking[stamp]] = _webp(pixels)
        except (BagError, UsageError, InfraError) as error:
            missing = str(error)
    steps = tuple(sorted(files))
    return Frames(steps=steps, files=tuple(files[step] for step in steps), missing=missing)


def _rendered(bag: Path, stamps_ns: Container[int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Stamp and pixels of some control steps; the camera is not asked for the others."""
    for now in observations(bag, lambda seq: seq * CONTROL_PERIOD_NS in stamps_ns):
        if now.image is not None:
            yield now.stamp_ns, now.image


def _webp(pixels: NDArray[np.uint8]) -> bytes:
    """One frame, (H, W, 3) uint8 RGB, as a file."""
    parameters = [cv2.IMWRITE_WEBP_QUALITY, _QUALITY]
    _, data = cv2.imencode('.webp', cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), parameters)
    return data.tobytes()
