"""Make the pictures of the gallery and of the front page: ``python docs/_site/films.py [NAME…]``.

Each section of ``docs/gallery.md`` has a picture ``gallery/NAME.webp`` and the command whose run it
shows. The command is executed as it stands there, and the film made from the bag that it leaves.
The front page has ``two_networks``, a film of two networks in the same scene, and ``report``, the
page of ``taxinet why`` in a browser (playwright and Chromium).
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from taxinet_ros.analysis.one_run.film import Picture, film_frames
from taxinet_ros.bag.run.recording import Recording, open_recording

DOCS = Path(__file__).resolve().parents[1]
SECTION = re.compile(
    r'^!\[[^\]]*\]\(gallery/(\w+)\.webp\)$.*?^```sh\n(.*?)^```$', re.MULTILINE | re.DOTALL
)
EVERY = 2
"""Which of ten frames a second are shown; half of them are half as large."""
SIZE = (450, 400)
QUALITY = 42
FRONT = (
    'taxinet run nominal --set distance_m=1400 --set cross_track_m=1 --set heading_deg=-3 '
    '--set time_of_day_h=9.5 --set clouds=clear --set duration_s=12'
)
FRONT_NETWORKS = {'original': '#B34700', 'taxinet': '#0072B2'}
"""Two networks, and the colours of their paths."""
VIEW = (404, 224)
GAP, HEAD, PLOT = 8, 26, 196
REPORT = (
    'taxinet falsify s_falsif --perception original --runs 60 --seed 3 --sampler random '
    '--engine loop --images none --out found',
    'taxinet why found --budget 200 --out why',
)


def run(command: str, cwd: Path | None = None) -> None:
    """Execute a command, whose runs may violate their requirement."""
    ended = subprocess.run(shlex.split(command), cwd=cwd, check=False)
    assert ended.returncode in (0, 1), command


def recording(command: str, out: Path) -> Recording:
    """The one run that a command makes."""
    run(f'{command} --out {out}')
    (bag,) = (folder for folder in out.iterdir() if (folder / 'metadata.yaml').exists())
    return open_recording(bag)


def save(pictures: Sequence[Image.Image], path: Path, quality: int = QUALITY) -> None:
    """Write an endless film in real time; the last picture stands for two seconds."""
    path.parent.mkdir(exist_ok=True)
    durations = [100 * EVERY] * (len(pictures) - 1) + [2000]
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=durations, loop=0,
        quality=quality, method=4,
    )
    print(f'{path}: {len(pictures)} frames, {path.stat().st_size / 1e6:.2f} MB')


def gallery(names: Sequence[str]) -> None:
    """Films of the gallery's sections; all where none is named."""
    for name, command in SECTION.findall((DOCS / 'gallery.md').read_text(encoding='utf-8')):
        if names and name not in names:
            continue
        command = re.sub(r'\s+# .*$', '', command.replace('\\\n', ' ').splitlines()[0])
        with tempfile.TemporaryDirectory() as scratch:
            frames = list(film_frames(recording(command, Path(scratch) / 'run')))[::EVERY]
            pictures = [
                Image.fromarray(frame).resize(SIZE, Image.Resampling.LANCZOS) for frame in frames
            ]
        save(pictures, DOCS / 'gallery' / f'{name}.webp')


def front() -> None:
    """The front page's film: what two networks see in one scene, and their paths on one plot."""
    with tempfile.TemporaryDirectory() as scratch:
        runs = [recording(f'{FRONT} --perception {word}', Path(scratch) / word)
                for word in FRONT_NETWORKS]
        views = [[frame.image for frame in one.frames()] for one in runs]
        paths = [one.trace['cte_m'].to_numpy() for one in runs]
    steps = range(0, max(map(len, paths)), EVERY)
    save([_front_picture(step, views, paths) for step in steps], DOCS / 'two_networks.webp', 50)


def _front_picture(
    step: int, views: Sequence[Sequence[Picture]], paths: Sequence[Picture]
) -> Image.Image:
    """Two pictures side by side above the paths until then; what has ended stands still."""
    width = 2 * VIEW[0] + GAP
    figure = Figure(figsize=(width / 100, (HEAD + VIEW[1] + PLOT) / 100), dpi=100)
    height = figure.bbox.height
    plot = figure.add_axes((0.055, 42 / height, 0.93, (PLOT - 74) / height))
    plot.axhspan(-1.5, 1.5, color='#009E73', alpha=0.18, linewidth=0)
    for side in (-15.24, 15.24):
        plot.axhline(side, color='0.3', linewidth=1.2)
    plot.text(0.1, 14.3, 'edge of the runway', va='top', fontsize=10)
    for column, ((word, colour), path) in enumerate(
        zip(FRONT_NETWORKS.items(), paths, strict=True)
    ):
        now = min(step, len(path) - 1)
        plot.plot(np.arange(now + 1) / 10, path[:now + 1], color=colour, linewidth=2.5)
        plot.plot(now / 10, path[now], 'o', color=colour)
        view = Image.fromarray(views[column][now]).resize(VIEW, Image.Resampling.LANCZOS)
        figure.figimage(np.asarray(view), column * (VIEW[0] + GAP), PLOT)
        figure.text(
            (column * (VIEW[0] + GAP) + 2) / width, 1 - HEAD / 2 / height,
            f'{word}: {abs(path[now]):.1f} m {"left" if path[now] > 0 else "right"}',
            color=colour, fontsize=12, fontweight='bold', va='center',
        )
    plot.set(xlim=(0, 12), ylim=(-18, 18), yticks=(-15, 0, 15))
    plot.set_title('distance from the centreline [m], left is up', fontsize=11, loc='left')
    plot.set_xlabel('time [s]', fontsize=10, labelpad=1)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy())


def report() -> None:
    """The front page's picture of a report: the upper part of a page of ``taxinet why``."""
    from playwright.sync_api import sync_playwright

    with tempfile.TemporaryDirectory() as scratch, sync_playwright() as playwright:
        for command in REPORT:
            run(command, Path(scratch))
        browser = playwright.chromium.launch(
            executable_path=shutil.which('chromium'), args=['--no-sandbox'])
        tab = browser.new_page(viewport={'width': 820, 'height': 1065})
        tab.goto((Path(scratch) / 'why' / 'why.html').as_uri())
        shown = Image.open(BytesIO(tab.screenshot()))
        browser.close()
    shown.convert('RGB').save(DOCS / 'report.webp', quality=60, method=6)


if __name__ == '__main__':
    asked = sys.argv[1:]
    others = {'two_networks': front, 'report': report}
    for name, make in others.items():
        if not asked or name in asked:
            make()
    if not asked or set(asked) - set(others):
        gallery(asked)
