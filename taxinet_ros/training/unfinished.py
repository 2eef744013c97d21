"""What an interrupted training has, in a folder ``NAME.part`` beside the network to be.

``request.json`` has its options, ``pictures.jsonl`` the rendered pictures as the network sees them,
and ``epochs.pt`` the state after its last epoch (:func:`taxinet_ros.training.fit.fit`). The folder
is removed when the network is written.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.atomic import disk_words
from taxinet_ros.files.journal import Journal
from taxinet_ros.training.data.dataset_folder import begin_request, check_request


class Unfinished:
    """The folder of a training that has not ended.

    Attributes:
        folder: its path.
        epochs: file of the state after the last epoch.
    """

    def __init__(self, out: Path) -> None:
        """``out``: the weights file that the training is to write."""
        self.folder = out.with_suffix('.part')
        self.epochs = self.folder / 'epochs.pt'
        self._pictures = self.folder / 'pictures.jsonl'

    @contextlib.contextmanager
    def open(
        self, request: Mapping[str, Any], *, resume: bool, overwrite: bool
    ) -> Iterator[Journal]:
        """Open the file of its pictures; the folder goes again if nothing comes of it.

        Args:
            request: all that the result depends on, by name.
            resume: whether to go on with what is there.
            overwrite: whether to begin anew instead of refusing to.

        Raises:
            UsageError: an interrupted training is there and not asked for, or none is there, or it
                was begun with another request, or another command writes to it.
            RecordError: something could not be written; what is there is kept.
        """
        if resume:
            check_request('train', self.folder, request)
        elif self.folder.exists() and not overwrite:
            raise UsageError(
                f'train: {self.folder}: an interrupted training; add --resume to go on with it, or '
                '--overwrite to begin anew'
            )
        else:
            self.remove()
            begin_request('train', self.folder, request)
        try:
            pictures = Journal(self._pictures)
            try:
                yield pictures
            finally:
                pictures.close()
                if not self.begun:
                    self.remove()
        except BlockingIOError as error:
            raise UsageError(f'train: {self.folder}: another training writes to it') from error
        except OSError as error:
            raise RecordError(
                f'train: {error.filename or self.folder}: {disk_words(error)}; mend that, then go '
                'on with --resume'
            ) from error

    @property
    def begun(self) -> bool:
        """Whether a picture or an epoch is there to go on with."""
        pictures = self._pictures
        return self.epochs.exists() or (pictures.exists() and pictures.stat().st_size > 0)

    def remove(self) -> None:
        """Remove the folder, if it is there."""
        with contextlib.suppress(FileNotFoundError):
            shutil.rmtree(self.folder)
