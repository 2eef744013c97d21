"""Make the films of the gallery and of the front page: ``python docs/_site/films.py [NAME…]``.

Each section of ``docs/gallery.md`` has a picture ``gallery/NAME.webp`` and the command whose run it
shows. The command is executed as it stands there, and the film made from the bag that it leaves.
The front page's film shows two networks in the same scene, side by side.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path

import numpy as np
from PIL import Image

from taxinet_ros.analysis.one_run.film import ACCENTS, film_frames
from taxinet_ros.bag.run.recording import open_recording

DOCS = Path(__file__).resolve().parents[1]
SECTION = re.compile(
    r'^!\[[^\]]*\]\(gallery/(\w+)\.webp\)$.*?^```sh\n(.*?)^```$', re.MULTILINE | re.DOTALL
)
EVERY = 2
"""Of ten frames a second; a film at five a second plays everywhere, and is half as large."""
SIZE = (450, 400)
QUALITY = 42
COLOURS = 112
FRONT = 'taxinet run nominal --set distance_m=1300 --set time_of_day_h=10 --set duration_s=14'
FRONT_NETWORKS = ('original', 'taxinet')
FRONT_SIZE = (360, 320)


def recorded(command: str, out: Path) -> Iterator[Image.Image]:
    """The film of the one run that a command makes, as pictures of 1080 x 960."""
    words = shlex.split(command)
    ended = subprocess.run([*words, '--out', str(out)], check=False)
    assert ended.returncode in (0, 1), command
    (bag,) = (folder for folder in out.iterdir() if (folder / 'metadata.yaml').exists())
    for number, frame in enumerate(film_frames(open_recording(bag))):
        if number % EVERY == 0:
            yield Image.fromarray(frame)


def save(pictures: Sequence[Image.Image], path: Path) -> None:
    """Write an endless film in real time; the last picture stands for two seconds."""
    path.parent.mkdir(exist_ok=True)
    step_ms = 100 * EVERY
    durations = [step_ms] * (len(pictures) - 1) + [2000]
    options = {'quality': QUALITY, 'method': 6} if path.suffix == '.webp' else {'optimize': True}
    pictures[0].save(
        path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, **options,
    )
    print(f'{path}: {len(pictures)} frames, {path.stat().st_size / 1e6:.2f} MB')


def gallery(names: Sequence[str]) -> None:
    """Films of the gallery's sections; all where none is named."""
    for name, command in SECTION.findall((DOCS / 'gallery.md').read_text(encoding='utf-8')):
        if names and name not in names:
            continue
        command = re.sub(r'\s+# .*$', '', command.replace('\\\n', ' ').splitlines()[0])
        with tempfile.TemporaryDirectory() as scratch:
            pictures = [
                picture.resize(SIZE, Image.Resampling.LANCZOS)
                for picture in recorded(command, Path(scratch) / 'run')
            ]
        save(pictures, DOCS / 'gallery' / f'{name}.webp')


def front() -> None:
    """The front page's film, ``docs/two_networks.gif``: a failing and a passing run."""
    width, height = FRONT_SIZE
    with tempfile.TemporaryDirectory() as scratch:
        sides = [
            list(recorded(f'{FRONT} --perception {word}', Path(scratch) / word))
            for word in FRONT_NETWORKS
        ]
    pictures = []
    for pair in zip_longest(*sides):
        both = Image.new('RGB', (2 * width + 8, height), 'white')
        for column, picture in enumerate(pair):
            shown = picture or sides[column][-1]
            small = shown.resize(FRONT_SIZE, Image.Resampling.LANCZOS)
            both.paste(small, (column * (width + 8), 0))
        pictures.append(both)
    # Curves are few pixels, and their colours have a meaning.
    curves = [Image.new('RGB', (pictures[0].width, 40), colour) for colour in ACCENTS]
    sample = np.vstack([np.asarray(one) for one in (*pictures[::10], *curves)])
    palette = Image.fromarray(sample).quantize(COLOURS)
    save([one.quantize(palette=palette, dither=Image.Dither.NONE) for one in pictures],
         DOCS / 'two_networks.gif')


if __name__ == '__main__':
    asked = sys.argv[1:]
    if not asked or 'two_networks' in asked:
        front()
    if asked != ['two_networks']:
        gallery(asked)
