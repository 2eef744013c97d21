"""Options of a training, validated before any work."""

from __future__ import annotations

import math
import os
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from taxinet_ros.core.perception.eye import VIEWS
from taxinet_ros.core.perception.network import ARCHITECTURES, DEFAULT_ARCHITECTURE
from taxinet_ros.core.perception.weights import SUFFIX, Source, card_path
from taxinet_ros.errors import UsageError
from taxinet_ros.training.data.dataset import SAMPLERS
from taxinet_ros.training.data.portions import Portion
from taxinet_ros.training.data.unfinished import is_begun
from taxinet_ros.version import __version__

_LIMITS: dict[str, tuple[float, float]] = {
    'images': (1, 1_000_000),
    'validation': (1, 1_000_000),
    'epochs': (1, 10_000),
    'batch': (1, 65_536),
    'learning_rate': (1e-8, 1.0),
    'seed': (0, 2**63 - 1),
    'workers': (1, 256),
}
DEVICES = ('cpu', 'cuda')
"""Where a network can be trained."""
_WITHOUT_EFFECT = ('out', 'workers', 'overwrite', 'resume')
"""Options on which the weights do not depend."""
_KEPT = ('.db', '.db-journal', '.pt')
"""Suffixes of the files of an unfinished training."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainOptions:
    """Options of a training; numbers are checked on construction.

    Attributes:
        out: weights file to write, ``NAME.safetensors``; its card becomes ``NAME.json``, its
            learning curves ``NAME.png`` and ``NAME.csv``.
        program: word of a shipped Scenic program or path of one, or None to train on ``data``.
        data: folders of labelled images, or none to train on ``program``.
        validation_data: folder of the validation images; None to hold out some of the others.
        sampler: sampler of the program's scenes, a word of
            :data:`~taxinet_ros.training.data.dataset.SAMPLERS`.
        validation_program: program of the validation scenes, which are those that a training on it
            with the same seed and number of images would hold out; None for ``program``.
        add: pictures added to those of ``program``, with validation pictures in proportion.
        add_data: folders of labelled images added to the training, none of which is held out: of
            a recording, neighbours would be on both sides.
        places: places of the scenes in place of a program, words of
            :func:`~taxinet_ros.training.data.places.named_places`.
        architecture: layers of the network, a name of
            :data:`~taxinet_ros.core.perception.network.ARCHITECTURES`; None for those of the
            initial weights, else the default.
        view: virtual camera through which the network sees, a name of
            :data:`~taxinet_ros.core.perception.eye.VIEWS`; None for the frames as they are.
        start: initial weights, as a file or a shipped network's word; None for random ones.
        images: number of training pictures, one per scene of the program or of the places.
        validation: number of further scenes of the program or of other places, or rows of the
            data, held out to choose the epoch and to measure the errors.
        varied: whether the look of the rendered world varies.
        augment: whether every picture is augmented in each epoch.
        epochs: number of passes over all pictures.
        batch: pictures per step.
        learning_rate: maximum of the one-cycle schedule.
        seed: seed of everything random.
        device: where the network is trained, of :data:`DEVICES`; weights depend on it.
        workers: number of rendering processes, and of threads that read and augment; results do
            not depend on it.
        overwrite: whether the files of an earlier training may be replaced.
        resume: whether to go on with an interrupted training.

    Raises:
        UsageError: a number is out of range, or options are incompatible.
    """

    out: Path
    program: str | None = None
    data: tuple[Path, ...] = ()
    validation_data: Path | None = None
    sampler: str = 'random'
    validation_program: str | None = None
    add: tuple[Portion, ...] = ()
    add_data: tuple[Path, ...] = ()
    places: tuple[str, ...] = ()
    architecture: str | None = None
    view: str | None = None
    start: str | None = None
    images: int = 12_000
    validation: int = 1_500
    varied: bool = False
    augment: bool = False
    epochs: int = 20
    batch: int = 64
    learning_rate: float = 3e-3
    seed: int = 1
    device: str = 'cpu'
    workers: int = 2
    overwrite: bool = False
    resume: bool = False

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise UsageError(f'train: {name} is {value:g}, outside {low:g}..{high:g}')
        if (given := sum(map(bool, (self.program, self.places, self.data)))) != 1:
            which = ('several of', 'and') if given else ('neither', 'nor')
            raise UsageError(
                f'train: {which[0]} a program, places {which[1]} data given; give exactly one'
            )
        self._check_words()
        if self.data:
            self._check_data()
        elif self.validation_data is not None:
            raise UsageError('train: validation_data goes with data, not with a program')
        elif self.sampler not in SAMPLERS:
            known = ', '.join(SAMPLERS)
            raise UsageError(f'train: sampler {self.sampler!r} is unknown; known: {known}')
        elif self.places and (self.sampler != 'random' or self.validation_program):
            option = 'validation_program' if self.validation_program else 'sampler'
            raise UsageError(f'train: {option} goes with a program, not with places')
        else:
            self.check_batch(self.images)

    def check_batch(self, images: int) -> None:
        """Check that a batch is not more than all training pictures.

        Raises:
            UsageError: it is.
        """
        if self.batch > images:
            raise UsageError(
                f'train: a batch of {self.batch}, as asked or by default, is more than the '
                f'{images} images to train on; use a batch of {images} or less'
            )

    @property
    def architecture_name(self) -> str:
        """The architecture, or the default one."""
        return self.architecture or DEFAULT_ARCHITECTURE

    def _check_words(self) -> None:
        for name, known in (
            ('view', VIEWS), ('architecture', ARCHITECTURES), ('device', DEVICES)
        ):
            given = getattr(self, name)
            if given is not None and given not in known:
                raise UsageError(
                    f'train: {name} {given!r} is unknown; known: {", ".join(known)}'
                )

    def _check_data(self) -> None:
        for option, given in (
            ('varied', self.varied), ('sampler', self.sampler != 'random'),
            ('validation_program', self.validation_program),
            ('add or add_runs', self.add or self.add_data),
        ):
            if given:
                raise UsageError(
                    f'train: {option} is for rendered scenes; leave it out with data'
                )
        folders = [*self.data, *([self.validation_data] if self.validation_data else [])]
        seen: set[Path] = set()
        for folder in folders:
            if folder.resolve() in seen:
                raise UsageError(f'train: folder {folder} is given twice; name it once')
            seen.add(folder.resolve())

    @property
    def command_line(self) -> str:
        """The command that trains these weights, with every relevant option."""
        words = ['taxinet', 'train', *([] if self.program is None else [self.program])]
        words += map(str, self.data)
        for place in self.places:
            words += ['--place', place]
        words += [] if self.view is None else ['--view', self.view]
        words += [] if self.architecture is None else ['--architecture', self.architecture]
        if self.validation_data is not None:
            words += ['--validation-data', str(self.validation_data)]
        words += self._rendering_words()
        if self.start is not None:
            words += ['--start', self.start]
        words += ['--varied'] * self.varied + ['--augment'] * self.augment
        for name in self._numbers():
            words += [f'--{name.replace("_", "-")}', f'{getattr(self, name)}']
        words += [] if self.device == 'cpu' else ['--device', self.device]
        return shlex.join([*words, '--out', self.out.name])

    @property
    def unfinished(self) -> Path:
        """Folder of the pictures and of the last epoch, until the training has ended."""
        return self.out.with_suffix('.part')

    @property
    def interrupted(self) -> bool:
        """Whether there is a training to go on with; a folder without its record is none."""
        return is_begun(self.unfinished)

    def request(self, sources: Sequence[Source], start: str) -> dict[str, str]:
        """All that the weights depend on, by name.

        Args:
            sources: origins of the pictures.
            start: SHA-256 of the initial weights, or ''.
        """
        given = {field.name: getattr(self, field.name) for field in fields(self)}
        options = {
            name: ' '.join(map(str, value)) if isinstance(value, tuple) else value
            for name, value in given.items() if name not in _WITHOUT_EFFECT
        }
        digests = {f'{source.kind} {source.name} (sha256)': source.sha256 for source in sources}
        found = {**options, **digests, 'start_sha256': start, 'package_version': __version__}
        return {name: str(value or 'none') for name, value in found.items()}

    def _rendering_words(self) -> list[str]:
        words = ['--sampler', self.sampler] if self.sampler != 'random' else []
        if self.validation_program is not None:
            words += ['--validation-program', self.validation_program]
        for portion in self.add:
            words += ['--add' if portion.kind == 'program' else '--add-runs', str(portion)]
        for folder in self.add_data:
            words += ['--add', str(folder)]
        return words

    def _numbers(self) -> list[str]:
        names = [] if self.data else ['images']
        names += ['validation'] if self.validation_data is None else []
        return [*names, 'epochs', 'batch', 'learning_rate', 'seed']

    @property
    def curves_path(self) -> Path:
        """Path of the picture of the learning curves."""
        return self.out.with_suffix('.png')

    @property
    def history_path(self) -> Path:
        """Path of the table of the learning curves."""
        return self.out.with_suffix('.csv')

    def check_out(self) -> None:
        """Check that the result can be written, before hours of training.

        Raises:
            UsageError: the suffix is wrong, the folder missing or unwritable, or the file exists.
        """
        out = self.out
        if out.suffix != SUFFIX:
            raise UsageError(
                f'train: out {out}: networks are {SUFFIX} files; use {out.stem}{SUFFIX}'
            )
        if not out.parent.is_dir():
            raise UsageError(f'train: out {out}: {out.parent} is not a folder; make it first')
        if not os.access(out.parent, os.W_OK | os.X_OK):
            raise UsageError(f'train: out {out}: {out.parent} cannot be written to')
        ours = self.resume and self.interrupted  # stopped while these files were written
        if out.is_dir() or (out.exists() and not (self.overwrite or ours)):
            raise UsageError(
                f'train: out {out}: already exists; choose another file, or overwrite it'
            )
        if not self.interrupted and _holds_others(self.unfinished):
            raise UsageError(
                f'train: out {out}: would also make the folder {self.unfinished}, which is there '
                'with something else; choose another name, or move that away'
            )
        if self.interrupted and not (self.resume or self.overwrite):
            raise UsageError(
                f'train: {self.unfinished}: an interrupted training; resume to go on with '
                'it, or overwrite to begin anew'
            )
        others = {'its card': card_path(out), 'learning curves': self.curves_path,
                  'the table of them': self.history_path}
        for what, path in others.items():
            # Without weights, they are of no earlier training.
            if path.is_dir() or (path.exists() and not (out.exists() or ours)):
                raise UsageError(
                    f'train: out {out}: would also write {path} ({what}), which exists; choose '
                    'another name, or move that away'
                )


def _holds_others(folder: Path) -> bool:
    """Whether something is there that no training has left."""
    if not folder.is_dir():
        return folder.exists()
    return any(path.suffix not in _KEPT for path in folder.iterdir())
