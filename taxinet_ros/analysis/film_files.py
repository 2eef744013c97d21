"""Films as files: MP4 by OpenCV, GIF by Pillow."""

from __future__ import annotations

import errno
import itertools
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor

from taxinet_ros.bag.layout import write_whole

Picture = NDArray[np.uint8]

FRAMES_PER_S = 10
_GIF_EVERY = 2
_GIF_SHRINK = 2
_GIF_COLOURS = 150
_SHADES = 6


def write_mp4(frames: Iterable[Picture], path: Path) -> int:
    """Write frames, (H, W, 3) uint8 RGB of even size, as MPEG-4 video in real time.

    The codec is MPEG-4 part 2: the headless OpenCV wheels have no H.264, and VP9 takes fifty
    times as long.

    Returns:
        Number of frames.

    Raises:
        BagWriteError: it cannot be written.
    """
    return write_whole(path, lambda draft: _encode(frames, draft))


def write_gif(frames: Iterable[Picture], path: Path, accents: Sequence[str] = ()) -> int:
    """Write every second frame at half size as an endless GIF, in real time.

    Args:
        frames: (H, W, 3) uint8 RGB.
        path: new file.
        accents: colours such as ``#0072B2`` that few pixels have and that must not be lost.

    Returns:
        Number of frames.

    Raises:
        BagWriteError: it cannot be written.
    """
    return write_whole(path, lambda draft: _animate(_small(frames, accents), draft))


def _encode(frames: Iterable[Picture], path: Path) -> int:
    source = iter(frames)
    first = next(source)
    size = (first.shape[1], first.shape[0])
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'mp4v'), FRAMES_PER_S, size)
    if not writer.isOpened():
        raise OSError(errno.EIO, 'OpenCV opens no MPEG-4 encoder for it')
    count = 0
    for frame in itertools.chain([first], source):
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        count += 1
    writer.release()
    # OpenCV does not tell when the disk is full.
    if (stored := _frames_in(path)) != count:
        raise OSError(errno.ENOSPC, f'{stored} of {count} frames reached the disk')
    return count


def _frames_in(path: Path) -> int:
    capture = cv2.VideoCapture(str(path))
    try:
        return int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() else 0
    finally:
        capture.release()


def _animate(pictures: Iterator[Image.Image], path: Path) -> int:
    first = next(pictures)
    count = 1

    def rest() -> Iterator[Image.Image]:
        nonlocal count
        for picture in pictures:
            count += 1
            yield picture

    first.save(
        path, save_all=True, append_images=rest(), loop=0, optimize=False,
        duration=1000 * _GIF_EVERY // FRAMES_PER_S,
    )
    return count


def _small(frames: Iterable[Picture], accents: Sequence[str]) -> Iterator[Image.Image]:
    """Every second frame, half as large, with the colours that it has most of, and the accents."""
    fixed = [channel for accent in accents for channel in _fading(accent)]
    palette = Image.new('P', (1, 1))
    for frame in itertools.islice(frames, 0, None, _GIF_EVERY):
        height, width = frame.shape[:2]
        size = (width // _GIF_SHRINK, height // _GIF_SHRINK)
        picture = Image.fromarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA))
        own = picture.quantize(_GIF_COLOURS).getpalette() or []
        colours = own[:3 * _GIF_COLOURS] + fixed
        palette.putpalette(colours + colours[-3:] * (256 - len(colours) // 3))
        yield picture.quantize(palette=palette, dither=Image.Dither.NONE)


def _fading(colour: str) -> list[int]:
    """Red, green, blue of a colour, and of the shades in which it fades into white."""
    pure = np.array(ImageColor.getrgb(colour)[:3])
    return [
        int(channel)
        for share in np.linspace(0, 0.85, _SHADES)
        for channel in pure + (255 - pure) * share
    ]
