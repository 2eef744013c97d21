"""Serialise camera frames as ``sensor_msgs/msg/Image``, with the same bytes as ROS.

Frames are most of a run's data, so they are handled as bytes: conversion to a message object and
back would copy them six times.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.types import NS_PER_S

ENCAPSULATION = b'\x00\x01\x00\x00'  # CDR, little endian
_ENCODING = b'rgb8'
_COUNT, _PAIR = struct.Struct('<I'), struct.Struct('<II')


def image_cdr(pixels: NDArray[np.uint8], stamp_ns: int, frame_id: str) -> bytes:
    """Serialise one frame, with zeros in the alignment gaps.

    Args:
        pixels: (H, W, 3) uint8 RGB.
        stamp_ns: simulated time since the start of the run [ns].
        frame_id: frame of the camera.
    """
    height, width, channels = pixels.shape
    body = struct.pack('<iI', stamp_ns // NS_PER_S, stamp_ns % NS_PER_S)
    body = with_text(body, frame_id.encode())
    body = aligned(body) + struct.pack('<II', height, width)
    body = with_text(body, _ENCODING) + b'\x00'  # is_bigendian: 0
    body = aligned(body) + struct.pack('<II', width * channels, pixels.size)
    return b''.join((ENCAPSULATION, body, np.ascontiguousarray(pixels).data))


def frame_of_cdr(cdr: bytes) -> tuple[int, NDArray[np.uint8]]:
    """Stamp [ns] and pixels (H, W, 3) uint8 RGB of a serialised image; a view of its memory.

    Raises:
        ValueError: another encoding, or inconsistent size, step and data.
    """
    if cdr[:2] != ENCAPSULATION[:2]:
        raise ValueError('image is not little-endian CDR')
    try:
        sec, nanosec = _PAIR.unpack_from(cdr, 4)
        at = _after_text(cdr, 12)
        height, width = _PAIR.unpack_from(cdr, at)
        end = _after_text(cdr, at + 8, align=False)
        encoding = cdr[at + 12:end - 1].decode(errors='replace')
        at = end + 1 + -(end + 1) % 4
        step, size = _PAIR.unpack_from(cdr, at)
    except struct.error:
        raise ValueError(f'image of {len(cdr)} bytes ends before its pixels') from None
    if encoding != _ENCODING.decode():
        raise ValueError(f'image encoding is {encoding!r}, expected rgb8')
    if step != width * 3 or size != height * step or len(cdr) < at + 8 + size:
        raise ValueError(f'image of {width} x {height} has step {step} and {size} bytes')
    pixels = np.frombuffer(cdr, np.uint8, size, at + 8)
    return sec * NS_PER_S + nanosec, pixels.reshape(height, width, 3)


def _after_text(cdr: bytes, at: int, *, align: bool = True) -> int:
    (length,) = _COUNT.unpack_from(cdr, at)
    end = at + 4 + int(length)
    return end + -end % 4 if align else end


def with_text(body: bytes, text: bytes) -> bytes:
    """Append a string to a partial message without encapsulation."""
    return aligned(body) + struct.pack('<I', len(text) + 1) + text + b'\x00'


def aligned(body: bytes, size: int = 4) -> bytes:
    """Pad a partial message with zeros to a multiple of ``size`` bytes."""
    return body + bytes(-len(body) % size)
