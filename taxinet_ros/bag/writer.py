"""Record one run: a folder in rosbag2's layout with one MCAP file.

Deterministic: the same messages in the same order give the same bytes.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from mcap.records import Attachment

from taxinet_ros.bag.description import NOT_STARTED_NS, BagContent, file_text, record_text
from taxinet_ros.bag.errors import BagCorrupt, BagError, BagWriteError
from taxinet_ros.bag.layout import METADATA_FILE, mcap_path
from taxinet_ros.bag.storage.reader import read_statistics
from taxinet_ros.bag.storage.writer import StorageFile
from taxinet_ros.bag.topics import TopicInfo, check_topics
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import sync_folder, write_atomically
from taxinet_ros.version import __version__

_PACKAGE = 'taxinet_ros'
LIBRARY = f'{_PACKAGE} {__version__}'
MANIFEST = 'manifest.json'
MIN_FREE_BYTES = 1_000_000_000
"""Free disk space needed to start a bag [bytes]."""
RUN_METADATA = 'taxinet'
FREE_RUN_METADATA = 'taxinet_free_run'
"""Name of the metadata record of a free run's timing."""
FORK_METADATA = 'taxinet_fork'
"""Name of the metadata record of what a forked run was forked from."""

_MEDIA_TYPES = {
    '.json': 'application/json',
    '.yaml': 'application/yaml',
    '.scenic': 'text/plain',
    '.txt': 'text/plain',
}


@dataclass(frozen=True, kw_only=True)
class BagSummary:
    """Summary of a bag.

    Attributes:
        folder: the run folder.
        mcap: the storage file in it.
        message_counts: number of messages by topic name, including zeros.
        size_bytes: size of the storage file.
        start_ns, end_ns: minimum and maximum stamp [ns of simulated time]; 0 without messages.
    """

    folder: Path
    mcap: Path
    message_counts: Mapping[str, int]
    size_bytes: int
    start_ns: int
    end_ns: int


class BagWriter:
    """Writes a run's messages.

    The storage file has its final name from the start, and everything before the last
    :meth:`flush` is readable even if this process is killed; :meth:`close` adds ``metadata.yaml``,
    which marks the bag as complete. As a context manager it closes on success and abandons on an
    exception.

    Attributes:
        folder: the run folder.
    """

    def __init__(
        self, folder: Path, topics: Sequence[TopicInfo], *, metadata: Mapping[str, str],
        attachments: Mapping[str, bytes], min_free_bytes: int = MIN_FREE_BYTES,
        beside: Mapping[str, str] | None = None, make_parents: bool = True,
    ) -> None:
        """Start a bag.

        Args:
            folder: the run folder, named like the run; it must not exist.
            topics: all topics that may be written.
            metadata: metadata of the run (scenario, seed, versions, perception), stored as custom
                data.
            attachments: files to attach, by name; ``manifest.json`` is added if not given.
            min_free_bytes: required free disk space at the start [bytes]; a tenth of it is kept
                free while recording.
            beside: metadata for ``metadata.yaml`` only, which may differ between bags of equal
                runs, such as the commit.
            make_parents: whether to create the folder's parents.

        Raises:
            UsageError: the folder exists, there is too little space, or a topic is malformed.
            BagWriteError: an error of the operating system.
        """
        check_topics(topics)
        _check_words('metadata', {**metadata, **(beside or {})})
        _make_folder(folder, min_free_bytes, make_parents)
        self.folder = folder
        self._topics = tuple(topics)
        self._custom = dict(metadata)
        self._beside = dict(beside or {})
        self._storage = StorageFile(
            mcap_path(folder), topics=self._topics, library=LIBRARY,
            keep_free_bytes=min_free_bytes // 10,
        )
        self.add_metadata('rosbag2', {'serialized_metadata': record_text(self._content())})
        if metadata:
            self.add_metadata(RUN_METADATA, metadata)
        for name, data in {MANIFEST: self._manifest(), **attachments}.items():
            self.attach(name, data)

    def write(
        self, topic: str, cdr: bytes, stamp_ns: int, published_ns: int | None = None
    ) -> None:
        """Append one serialised message.

        Args:
            topic: name of one of the bag's topics.
            cdr: the message with its encapsulation of four bytes.
            stamp_ns: simulated time [ns], not negative; the log time.
            published_ns: the publish time [ns]; None: the log time.
        """
        if topic not in self._storage.counts:
            raise UsageError(f'topic {topic!r} is not in bag {self.folder}; give it at its start')
        if not 0 <= stamp_ns < NOT_STARTED_NS:
            raise UsageError(f'topic {topic!r}: stamp {stamp_ns} ns is not within 0 ... 2^63-2')
        self._storage.add_message(
            topic, cdr, stamp_ns, stamp_ns if published_ns is None else published_ns
        )

    def flush(self) -> None:
        """Flush to the operating system: data survive the end of this process, not a power loss."""
        self._storage.finish_chunk()

    def attach(self, name: str, data: bytes) -> None:
        """Add an attachment, stamped with the latest message's time."""
        media_type = _MEDIA_TYPES.get(Path(name).suffix, 'application/octet-stream')
        now_ns = self._storage.end_ns
        self.copy_attachment(Attachment(
            create_time=now_ns, log_time=now_ns, name=name, media_type=media_type, data=data,
        ))

    def copy_attachment(self, attachment: Attachment) -> None:
        """Add an attachment as it is in another bag; a name may be repeated."""
        self._storage.add_attachment(attachment)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        _check_words(name, values)
        self._storage.add_metadata(name, values)

    def close(self) -> BagSummary:
        """Complete the bag, verify it on disk, and then mark it as complete.

        Raises:
            BagWriteError: a write failed, now or earlier.
            BagCorrupt: the message counts on disk differ from those written.
        """
        self.add_metadata('rosbag2', {'serialized_metadata': record_text(self._content())})
        self._storage.finish()
        self._storage.output.sync()
        self._storage.output.close()
        self._verify()
        try:
            description = record_text(self._content(self._beside))
            write_atomically(self.folder / METADATA_FILE, file_text(description))
            sync_folder(self.folder.parent)
        except OSError as error:
            raise _refused(self.folder / METADATA_FILE, error) from error
        return self.summary

    def abandon(self) -> None:
        """Stop without marking the bag as complete; keeps what was written. Never raises."""
        with suppress(BagError):
            self._storage.finish_chunk()
        with suppress(BagError):
            self._storage.output.close()

    def __enter__(self) -> BagWriter:
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close after success, abandon after an exception; nothing if already closed."""
        if kind is not None:
            self.abandon()
        elif self._storage.output.open:
            self.close()

    def _content(self, beside: Mapping[str, str] | None = None) -> BagContent:
        counts = self._storage.counts
        recorded = any(counts.values())
        return BagContent(
            file=self._storage.output.path.name,
            start_ns=self._storage.start_ns if recorded else NOT_STARTED_NS,
            duration_ns=self._storage.end_ns - self._storage.start_ns,
            topics=[(topic, counts[topic.name]) for topic in self._topics],
            custom={**self._custom, **(beside or {})},
        )

    def _manifest(self) -> bytes:
        topics = {t.name: {'type': t.type, 'type_hash': t.type_hash} for t in self._topics}
        content = {'library': LIBRARY, 'metadata': self._custom, 'topics': topics}
        return (json.dumps(content, indent=2) + '\n').encode()

    def _verify(self) -> None:
        path = self._storage.output.path
        found = read_statistics(path)
        if found != (expected := dict(self._storage.counts)):
            raise BagCorrupt(f'{path}: holds {found}, but {expected} was written', path=path)

    @property
    def summary(self) -> BagSummary:
        """Location and content of the bag so far."""
        return BagSummary(
            folder=self.folder,
            mcap=self._storage.output.path,
            message_counts=dict(self._storage.counts),
            size_bytes=self._storage.output.size,
            start_ns=self._storage.start_ns,
            end_ns=self._storage.end_ns,
        )


def is_own_manifest(data: bytes) -> bool:
    """Whether an attachment is the manifest of a bag of this package."""
    return data.startswith(f'{{\n  "library": "{_PACKAGE} '.encode())


def _check_words(name: str, values: Mapping[str, str]) -> None:
    for key, value in values.items():
        if not isinstance(key, str) or not isinstance(value, str):
            raise UsageError(f'bag metadata {name!r}: {key!r} is {value!r}; give text for both')


def free_bytes(folder: Path) -> int:
    """Free space on the disk of a folder, whether it exists yet or not [bytes]."""
    there = next((at for at in (folder, *folder.parents) if at.is_dir()), Path())
    return shutil.disk_usage(there).free


def check_room(folder: Path, wanted_bytes: int) -> None:
    """Check that there is enough room for bags on the disk of an existing folder.

    Raises:
        UsageError: there is less.
    """
    total, _, free = shutil.disk_usage(folder)
    if total and free < wanted_bytes:  # no disk, such as /proc, has no size
        raise UsageError(
            f'{folder}: {free / 1e9:.3f} GB free on the disk, {wanted_bytes / 1e9:.3f} GB wanted; '
            'make room or record elsewhere'
        )


def _make_folder(folder: Path, min_free_bytes: int, make_parents: bool) -> None:
    if folder.exists() or folder.is_symlink():
        text = 'already exists; nothing recorded is overwritten, name another folder'
        raise UsageError(f'{folder}: {text}')
    try:
        if make_parents:
            folder.parent.mkdir(parents=True, exist_ok=True)
        check_room(folder.parent, min_free_bytes)
        folder.mkdir()
    except OSError as error:
        raise _refused(folder, error) from error


def _refused(path: Path, error: OSError) -> BagWriteError:
    errno = error.errno or 0
    return BagWriteError(
        f'{path}: cannot write: [Errno {errno}] {error.strerror}', path=path, errno=errno
    )
