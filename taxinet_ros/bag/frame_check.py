"""Whether the camera frames in a bag are those that its run must have seen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.findings import Check, Finding
from taxinet_ros.bag.resimulate import WorldDiffers, observations
from taxinet_ros.bag.trace import Frame, read_images
from taxinet_ros.core.aircraft import CONTROL_PERIOD_NS
from taxinet_ros.core.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class FrameCheck:
    """Recorded frames held against frames rendered anew.

    Attributes:
        recorded: frames in the bag.
        equal: those whose every byte is the same.
        first_seq: control step of the first other one, or None.
        first_pixels: how many of its pixels are others.
        first_difference: greatest difference of a colour value in it, 0..255.
        trouble: why frames could not be rendered, or ''.
    """

    recorded: int
    equal: int
    first_seq: int | None = None
    first_pixels: int = 0
    first_difference: int = 0
    trouble: str = ''

    @property
    def ok(self) -> bool:
        """Whether every recorded frame is the right one."""
        return self.equal == self.recorded and not self.trouble


def frames_check(path: Path) -> Check:
    """:func:`check_frames` as one of the questions of a checkup; it is only read."""
    try:
        found = check_frames(path)
    except (BagError, UsageError) as error:
        return Check(name='frames', looked_at=f'not compared: {error}', skipped=True)
    words = f'{found.equal} of {found.recorded} equal those rendered anew'
    if not found.recorded:
        return Check(name='frames', looked_at='none in it to compare', skipped=True)
    if found.ok:
        return Check(name='frames', looked_at=f'{words}, bit for bit')
    finding = Finding(where='/camera/image_raw', what=found.trouble)
    if found.first_seq is not None:
        finding = Finding(
            where=f'step {found.first_seq}',
            what=f'the first other frame: {found.first_pixels} pixels differ, by up to '
            f'{found.first_difference} of 255',
        )
    return Check(name='frames', looked_at=words, findings=(finding,))


def check_frames(path: Path) -> FrameCheck:
    """Render every recorded frame of a bag once more, and compare.

    Raises:
        BagError, UsageError: the bag cannot be read.
    """
    recorded = equal = 0
    first: dict[str, int] = {}
    trouble = ''
    states = observations(path)
    for stamp_ns, image in read_images(path):
        recorded += 1
        seq = stamp_ns // CONTROL_PERIOD_NS
        try:
            now = None if trouble else next((s.image for s in states if s.seq == seq), None)
        except WorldDiffers as error:
            trouble, now = str(error), None
        if now is None:
            trouble = trouble or f'step {seq} has a frame and no recorded state'
        elif now.shape == image.shape and now.tobytes() == image.tobytes():
            equal += 1
        elif not first:
            first = _difference(seq, image, now)
    return FrameCheck(recorded=recorded, equal=equal, trouble=trouble, **first)


def _difference(seq: int, recorded: Frame, rendered: Frame) -> dict[str, int]:
    if recorded.shape != rendered.shape:
        return {'first_seq': seq, 'first_pixels': rendered[..., 0].size, 'first_difference': 255}
    away = np.abs(recorded.astype(np.int16) - rendered.astype(np.int16)).max(axis=2)
    return {
        'first_seq': seq, 'first_pixels': int(np.count_nonzero(away)),
        'first_difference': int(away.max()),
    }
