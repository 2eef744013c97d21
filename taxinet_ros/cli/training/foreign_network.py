"""``taxinet network``: convert a network of others, and see what it sees."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

from taxinet_ros.analysis.camera.network_view import draw_network_view, network_view
from taxinet_ros.cli.checked import check_output
from taxinet_ros.cli.training.camera import new_picture, write_picture
from taxinet_ros.core.perception.domain import domain_words
from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX
from taxinet_ros.core.perception.onnx.nnet import (
    converted,
    description_of,
    read_nnet,
    write_converted,
)
from taxinet_ros.core.perception.onnx.sidecar import sidecar_path
from taxinet_ros.core.perception.onnx.trial import tried_network
from taxinet_ros.core.perception.perception import find_domain
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.options import read_settings


def convert_nnet(file: Path, out: Path, description: str) -> None:
    """Convert a .nnet file to ONNX, with a description beside it, and print what it is.

    Raises:
        UsageError: a damaged file, a description that is not its own, or a name that is taken.
        OSError: the result cannot be written.
    """
    if out.suffix != ONNX_SUFFIX:
        raise UsageError(f'--out {out}: networks are {ONNX_SUFFIX} files; use {out.stem}.onnx')
    if not out.parent.is_dir():
        raise UsageError(f'--out {out}: {out.parent} is not a folder')
    content, source = description_of(description)
    beside = sidecar_path(out)
    own = beside.exists() and source.exists() and beside.samefile(source)
    if not own:
        check_output(f'--out {out}: {beside}', beside)
    for path in (out, *(() if own else (beside,))):
        if path.exists() or path.is_symlink():
            raise UsageError(f'--out {out}: {path} already exists; choose a new name')
    found = converted(file, read_nnet(file), out, content, source)
    nnet = found.nnet
    hidden = ', '.join(map(str, nnet.sizes[1:-1])) or 'no'
    write_converted(found)
    print(f'{file}: {nnet.sizes[0]} inputs, {hidden} hidden neurons, {nnet.sizes[-1]} outputs; '
          f'SHA-256 {nnet.sha256}')
    print(f'as ONNX, its answers to random inputs differ by at most {found.difference:.1g}')
    print(f'written: {out}, {beside} (description: {source})')


def show_network_view(network: Path, settings: Iterable[str], out: Path | None) -> None:
    """Draw what a network gets to see of a scene's first frame; print its answer and the truth.

    Raises:
        UsageError: an unusable network, bad settings, or a file that cannot be written.
    """
    scene = scenario_from_human(read_settings(settings))
    loaded, _ = tried_network(network)
    path = new_picture(out, f'network-{network.stem}')
    found = network_view(loaded, scene)
    truth = _words(scene.cross_track_m, scene.heading_rad)
    answer = _words(found.cte_m, found.he_rad)
    title = f'truth: {truth}; {network.name}: {answer}'
    write_picture(path, lambda: draw_network_view(found, title, path))
    domain = domain_words(find_domain(str(network)))
    print(f'truth {truth}\nanswer {answer}\ndomain {domain}\npicture: {path}')


def _words(cte_m: float, he_rad: float) -> str:
    return f'CTE {cte_m:+.2f} m, HE {math.degrees(he_rad):+.1f} deg'
