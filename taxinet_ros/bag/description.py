"""Reading ``metadata.yaml``: what a bag's folder says of the bag, which is not simply believed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.yaml_text import MAX_CHARS, load_yaml
from taxinet_ros.core.provenance import known

_ROOT = 'rosbag2_bagfile_information'


def words_beside(path: Path, words: Mapping[str, str]) -> dict[str, str]:
    """What ``metadata.yaml`` says of a run besides the words within the bag, such as the commit.

    Args:
        path: a run folder; of an ``.mcap`` file nothing is beside it.
        words: those within the bag.
    """
    try:
        custom = read_description(path).get('custom_data') if path.is_dir() else None
    except BagError:
        return {}
    return {name: value for name, value in known(custom).items() if name not in words}


def read_description(folder: Path) -> Mapping[str, Any]:
    """The values of ``metadata.yaml`` in ``folder``, ``message_count`` among them.

    Raises:
        BagTruncated: there is none, so the recording was not finished.
        BagCorrupt: it is no bag description.
    """
    file = folder / METADATA_FILE
    if not file.is_file():
        text = f'{folder}: no {METADATA_FILE}, so the recording was not finished'
        raise BagTruncated(text, path=folder)
    try:
        with file.open(encoding='utf-8') as stream:
            values = load_yaml(stream.read(MAX_CHARS + 1))[_ROOT]
        values['message_count']
    except (OSError, ValueError, KeyError, TypeError) as error:
        kind = type(error).__name__
        raise BagCorrupt(f'{file}: not a bag description: {kind}', path=file) from error
    return dict(values)
