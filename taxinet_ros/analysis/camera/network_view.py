"""What a network gets to see of a camera frame: the frame, and the picture made of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from taxinet_ros.analysis.camera.sheets import scene_picture
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.network import usual_frame
from taxinet_ros.core.perception.onnx.network import OnnxNetwork, prepare
from taxinet_ros.core.scenario import Scenario


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NetworkView:
    """A scene's first frame before an ONNX network.

    Attributes:
        frame: camera frame, (200, 360, 3) uint8 RGB.
        crop: left, top, right and bottom of what is used of it [pixels].
        picture: the network's input, (height, width, channels), in its own numbers.
        cte_m, he_rad: its answer, left positive.
    """

    frame: NDArray[np.uint8]
    crop: tuple[int, int, int, int]
    picture: NDArray[np.float32]
    cte_m: float
    he_rad: float


def network_view(network: OnnxNetwork, scene: Scenario) -> NetworkView:
    """Show the first frame of a scene to a network."""
    sidecar, picture = network.sidecar, scene_picture(scene)
    frame = seen = usual_frame(picture)
    if sidecar.picture.view is not None:
        seen = find_eye(sidecar.picture.view, scene.rig).see(picture)
    picture = prepare(seen, sidecar)[0]
    if sidecar.picture.layout == 'nchw':
        picture = picture.transpose(1, 2, 0)
    shape = (sidecar.picture.height, sidecar.picture.width, -1)
    cte_m, he_rad = network.look(seen)
    return NetworkView(
        frame=frame, crop=sidecar.picture.crop, picture=picture.reshape(shape), cte_m=cte_m,
        he_rad=he_rad,
    )


def draw_network_view(found: NetworkView, title: str, path: Path) -> None:
    """Draw the frame with its crop into a PNG file, and beside it the network's input."""
    figure = Figure(figsize=(11.0, 3.4), dpi=100, layout='constrained')
    before, after = figure.subplots(1, 2)
    before.imshow(found.frame)
    left, top, right, bottom = found.crop
    before.add_patch(Rectangle(
        (left - 0.5, top - 0.5), right - left, bottom - top, fill=False, edgecolor='orange',
        linewidth=1.5,
    ))
    before.set_title('the frame, and what is used of it')
    low, high = float(found.picture.min()), float(found.picture.max())
    shown = (found.picture - low) / max(high - low, 1e-6)
    after.imshow(shown[..., 0] if shown.shape[2] == 1 else shown, cmap='gray')
    height, width = shown.shape[:2]
    after.set_title(f'the input: {width} x {height}, {low:.2f} (black) to {high:.2f} (white)')
    for axes in (before, after):
        axes.set(xticks=[], yticks=[])
    figure.suptitle(title)
    figure.savefig(path, format='png', metadata={'Software': None})
