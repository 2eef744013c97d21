"""The command as a person calls it; tests use helpers that lie beside other tests."""

import sys
from pathlib import Path

import pytest

from taxinet_ros.cli.main import main

for _room in ('analysis', 'cli', 'core', 'extras/evidence'):
    _folder = str(Path(__file__).resolve().parents[1] / _room)
    if _folder not in sys.path:
        sys.path.append(_folder)


@pytest.fixture
def taxinet(monkeypatch, capfd, tmp_path):
    """Call the command in an empty folder; exit code, output, complaints."""
    monkeypatch.chdir(tmp_path)

    def call(*words) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, 'argv', ['taxinet', *map(str, words)])
        with pytest.raises(SystemExit) as end:
            main()
        out, err = capfd.readouterr()
        return int(end.value.code or 0), out, err

    return call
