"""What a network gets to see of a camera frame: the frame, and the picture made of it."""

from __future__ import annotations

import math
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from taxinet_ros.analysis.camera.sheets import scene_picture
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.network import usual_frame
from taxinet_ros.core.perception.onnx.network import OnnxNetwork, prepare
from taxinet_ros.core.scenario import Scenario


def draw_network_view(network: OnnxNetwork, name: str, scene: Scenario, path: Path) -> str:
    """Draw the first frame of a scene, with what a network uses of it, and beside it its input.

    Args:
        network: the network.
        name: of its file.
        scene: the scene.
        path: PNG file to write.

    Returns:
        Truth and answer, a line each.
    """
    sidecar, seen = network.sidecar, scene_picture(scene)
    frame = usual_frame(seen)
    seen = frame if sidecar.picture.view is None else find_eye(
        sidecar.picture.view, scene.rig).see(seen)
    picture = prepare(seen, sidecar)[0]
    if sidecar.picture.layout == 'nchw':
        picture = picture.transpose(1, 2, 0)
    picture = picture.reshape((sidecar.picture.height, sidecar.picture.width, -1))
    truth = _words(scene.cross_track_m, scene.heading_rad)
    answer = _words(*network.look(seen))
    figure = Figure(figsize=(11.0, 3.4), dpi=100, layout='constrained')
    before, after = figure.subplots(1, 2)
    before.imshow(frame)
    left, top, right, bottom = sidecar.picture.crop
    before.add_patch(Rectangle(
        (left - 0.5, top - 0.5), right - left, bottom - top, fill=False, edgecolor='orange',
        linewidth=1.5,
    ))
    before.set_title('the frame, and what is used of it')
    low, high = float(picture.min()), float(picture.max())
    shown = (picture - low) / max(high - low, 1e-6)
    after.imshow(shown[..., 0] if shown.shape[2] == 1 else shown, cmap='gray')
    height, width = shown.shape[:2]
    after.set_title(f'the input: {width} x {height}, {low:.2f} (black) to {high:.2f} (white)')
    for axes in (before, after):
        axes.set(xticks=[], yticks=[])
    figure.suptitle(f'truth: {truth}; {name}: {answer}')
    figure.savefig(path, format='png', metadata={'Software': None})
    return f'truth {truth}\nanswer {answer}'


def _words(cte_m: float, he_rad: float) -> str:
    return f'CTE {cte_m:+.2f} m, HE {math.degrees(he_rad):+.1f} deg'
