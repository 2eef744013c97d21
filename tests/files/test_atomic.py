from __future__ import annotations

import errno
from pathlib import Path

import pytest

from taxinet_ros.files.atomic import draft_path, make_atomically, write_atomically


def test_given_text_or_bytes_when_written_then_that_alone_is_there(tmp_path: Path) -> None:
    path = tmp_path / 'a.json'
    draft_path(path).write_text('left by a kill, and longer than what comes')
    write_atomically(path, 'ü')
    assert path.read_bytes() == 'ü'.encode()
    write_atomically(path, b'\0', sync=False)
    assert path.read_bytes() == b'\0'
    assert list(tmp_path.iterdir()) == [path]


def test_given_a_disk_that_fills_up_then_the_old_file_stays_and_the_error_names_it(
    tmp_path: Path
) -> None:
    path = tmp_path / 'a.csv'
    path.write_text('old')

    def fill(draft: Path) -> None:
        assert (draft.parent, draft.suffix) == (path.parent, path.suffix)
        draft.write_text('half')
        raise OSError(errno.ENOSPC, 'No space left on device')

    with pytest.raises(OSError, match='No space left') as caught:
        make_atomically(path, fill)
    assert (caught.value.filename, caught.value.errno) == (str(path), errno.ENOSPC)
    assert [file.read_text() for file in tmp_path.iterdir()] == ['old']


def test_given_no_folder_then_the_error_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / 'gone' / 'a.csv'
    with pytest.raises(FileNotFoundError) as caught:
        write_atomically(path, 'text')
    assert caught.value.filename == str(path)
