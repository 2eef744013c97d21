"""The serialised ``sensor_msgs/msg/Image`` of a camera frame, the same bytes that ROS makes."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.types import NS_PER_S

_ENCAPSULATION = b'\x00\x01\x00\x00'  # CDR, little endian
_ENCODING = b'rgb8'


def image_cdr(pixels: NDArray[np.uint8], stamp_ns: int, frame_id: str) -> bytes:
    """Serialise one frame, with zeros in the gaps between the fields.

    Args:
        pixels: (H, W, 3) uint8 RGB.
        stamp_ns: simulated time since the start of the run [ns].
        frame_id: frame of the camera.
    """
    height, width, channels = pixels.shape
    body = struct.pack('<iI', stamp_ns // NS_PER_S, stamp_ns % NS_PER_S)
    body = _text(body, frame_id.encode())
    body = _aligned(body) + struct.pack('<II', height, width)
    body = _text(body, _ENCODING) + b'\x00'  # the byte: not big-endian
    body = _aligned(body) + struct.pack('<II', width * channels, pixels.size)
    return _ENCAPSULATION + body + pixels.tobytes()


def _text(body: bytes, text: bytes) -> bytes:
    return _aligned(body) + struct.pack('<I', len(text) + 1) + text + b'\x00'


def _aligned(body: bytes) -> bytes:
    return body + bytes(-len(body) % 4)
