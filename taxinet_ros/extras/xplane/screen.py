"""Pictures of X-Plane's window, taken from an X11 display, and the check that they are new.

X-Plane has no interface that gives pictures. It runs in full screen on a display of its own (a
virtual desktop, or Xvfb where OpenGL works there), or in a window that nothing covers.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.core.rig.camera_model import CameraModel
from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.extras.xplane.wire import failed

Picture = NDArray[np.uint8]

_LEAST_CODES = 2.0
"""Standard deviation of a picture that shows anything, in display codes."""


class Screen(Protocol):
    """Where pictures come from."""

    def grab(self) -> Picture:
        """The picture now, (height, width, 3) uint8 RGB.

        Raises:
            InfraError: it cannot be had.
        """
        ...

    def close(self) -> None:
        """Disconnect."""
        ...


class Display(Screen):
    """A region of an X11 display."""

    def __init__(self, display: str, region_px: tuple[int, int, int, int] | None) -> None:
        """Connect.

        Args:
            display: as ``:1``; '' for that of the environment.
            region_px: left, top, width and height; None for the first monitor.

        Raises:
            UsageError: the package mss is missing, or the region is not on the display.
            InfraError: there is no such display.
        """
        try:
            import mss
        except ImportError:
            raise UsageError(
                "x-plane: pictures need the package mss; pip install 'taxinet_ros[xplane]'"
            ) from None
        self._words = f'display {display or "of the environment"}'
        try:
            self._mss = mss.MSS(display=display or None)
            monitors = self._mss.monitors
        except Exception as error:  # of X11, by any of its ways
            text = str(error).partition('\n')[0]
            raise failed(InfraKind.NOT_READY, f'{self._words}: {text:.120}') from error
        whole, first = monitors[0], monitors[min(1, len(monitors) - 1)]
        left, top, width, height = region_px or tuple(
            first[key] for key in ('left', 'top', 'width', 'height')
        )
        if left + width > whole['width'] or top + height > whole['height']:
            self.close()
            raise UsageError(
                f'x-plane: region_px {left}, {top}, {width}, {height} is not within the '
                f'{whole["width"]} x {whole["height"]} of {self._words}'
            )
        self._region = {'left': left, 'top': top, 'width': width, 'height': height}

    def grab(self) -> Picture:
        """The picture now."""
        try:
            shot = self._mss.grab(self._region)
        except Exception as error:  # of X11, by any of its ways
            text = str(error).partition('\n')[0]
            raise failed(InfraKind.DIED, f'{self._words}: {text:.120}') from error
        bgra = np.frombuffer(shot.raw, np.uint8).reshape(shot.height, shot.width, 4)
        return np.ascontiguousarray(bgra[:, :, 2::-1])

    def close(self) -> None:
        """Disconnect."""
        self._mss.close()


def check_picture(picture: Picture, size_px: tuple[int, int]) -> None:
    """Check that a picture is of X-Plane's size and shows anything.

    Args:
        picture: as grabbed.
        size_px: width and height of X-Plane's window, as it says.

    Raises:
        InfraError: it is not, or does not.
    """
    height, width = picture.shape[:2]
    if (width, height) != size_px:
        raise failed(
            InfraKind.SIM, f'the picture has {width} x {height} pixels, the window of X-Plane '
            f'{size_px[0]} x {size_px[1]}; set region_px, or the resolution in X-Plane'
        )
    if picture.std() < _LEAST_CODES:
        raise failed(
            InfraKind.SIM, 'the picture has one colour: is X-Plane minimised, covered or on '
            'another desktop?'
        )


def field_of_view_deg(model: CameraModel, size_px: tuple[int, int]) -> float:
    """Horizontal field of view of a window that contains all of a camera's picture [deg].

    Args:
        model: the camera.
        size_px: width and height of the window.
    """
    width, height = size_px
    x, y = _rays(model)
    reach = max(float(np.abs(x).max()), float(np.abs(y).max()) * width / height)
    return float(np.degrees(2 * np.arctan(reach)))


def developed(picture: Picture, model: CameraModel, fov_deg: float) -> Picture:
    """The picture of a camera out of a window's, through its lens.

    The optical axis meets the middle of the window. A window with more pixels is shrunk before it
    is sampled, each pixel the mean of those it covers.

    Args:
        picture: of the window, a pinhole image.
        model: the camera.
        fov_deg: horizontal field of view of the window [deg].
    """
    import cv2

    height, width = picture.shape[:2]
    focal_px = width / 2 / np.tan(np.radians(fov_deg) / 2)
    shrink = min(1.0, max(model.focal_px) / focal_px)
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA) if shrink < 1 else picture
    x, y = _rays(model)
    # Pixel centres are integers: the middle of the window is half a pixel before the middle one.
    u = (focal_px * x + width / 2) * size[0] / width - 0.5
    v = (focal_px * y + height / 2) * size[1] / height - 0.5
    return np.asarray(cv2.remap(
        small, u.astype(np.float32), v.astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ))


def _rays(model: CameraModel) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Undistorted directions x/z and y/z of a camera's pixels, (height, width) each."""
    matrix, _, u, v = model.inner_view
    return (u - matrix[0, 2]) / matrix[0, 0], (v - matrix[1, 2]) / matrix[1, 1]
