"""Write hashes.txt: what every file of the versions in constraints.txt has to be.

``.venv/bin/python .ci/hashes.py`` asks the indexes that pip is set up for (options of ``pip
config`` and ``PIP_*`` variables: index-url, extra-index-url, find-links) for the SHA-256 of all
files of each pinned version, for every platform and Python that it is served for, and adds them
to those that are known for the same version. With another version of constraints.txt come other
hashes; run it after each change there, and look through what it changes before committing it.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from packaging.utils import canonicalize_name, parse_sdist_filename, parse_wheel_filename
from pip._internal.models.index import PyPI

REPOSITORY = Path(__file__).resolve().parent.parent
PINS, HASHES = REPOSITORY / 'constraints.txt', REPOSITORY / 'hashes.txt'
JSON = 'application/vnd.pypi.simple.v1+json'
HEAD = """\
# SHA-256 of every file of the versions in constraints.txt; written by .ci/hashes.py.
#   make HASHES=yes    installs nothing of them that is another file
"""


class Links(HTMLParser):
    """File names and hashes out of an index page in HTML (PEP 503)."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, str]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take in a link."""
        place, _, fragment = (dict(attrs).get('href') or '').partition('#')
        if tag == 'a' and fragment.startswith('sha256='):
            self.found.append((unquote(urlsplit(place).path.rsplit('/', 1)[-1]), fragment[7:]))


def setting(name: str) -> list[str]:
    """Words of an option of pip's, from its files or the environment."""
    variable = 'PIP_' + name.replace('-', '_').upper()
    if variable in os.environ:
        return os.environ[variable].split()
    command = [sys.executable, '-m', 'pip', 'config', 'get', f'global.{name}']
    return subprocess.run(command, capture_output=True, text=True).stdout.split()


def listed(index: str, name: str) -> list[tuple[str, str]]:
    """File names and hashes that an index has for a project; none where it does not know it."""
    address = f'{index.rstrip("/")}/{name}/'
    if address.startswith('file:'):
        address += 'index.html'
    request = urllib.request.Request(address, headers={'Accept': f'{JSON}, text/html;q=0.5'})
    try:
        with urllib.request.urlopen(request, timeout=60) as answer:
            page, kind = answer.read().decode(), answer.headers.get_content_type()
    except urllib.error.URLError as error:
        gone = getattr(error, 'code', 404) == 404
        if not gone:
            raise
        return []
    if kind == JSON:
        return [(file['filename'], file['hashes'].get('sha256', ''))
                for file in json.loads(page)['files']]
    return Links(page).found


def beside(folder: str) -> Iterator[tuple[str, str]]:
    """File names and hashes in a folder that pip looks into."""
    place = Path(folder.removeprefix('file://'))
    for file in sorted(place.iterdir()) if place.is_dir() else ():
        if file.suffix in ('.whl', '.gz', '.zip'):
            yield file.name, hashlib.sha256(file.read_bytes()).hexdigest()


def named(file: str) -> tuple[str, str]:
    """Project and public version of a file; none of what is no wheel and no source archive."""
    try:
        name, version = (
            parse_wheel_filename(file)[:2] if file.endswith('.whl') else parse_sdist_filename(file)
        )
    except ValueError:
        return '', ''
    return name, version.public


def pins() -> dict[str, str]:
    """Versions by project."""
    lines = re.findall(r'^([\w.-]+)==(\S+)$', PINS.read_text(), re.MULTILINE)
    return {canonicalize_name(name): version for name, version in lines}


def known() -> dict[tuple[str, str], set[str]]:
    """Hashes in the file as it is, by project and version."""
    text = HASHES.read_text().replace('\\\n', '') if HASHES.exists() else ''
    return {
        (name, version): set(re.findall(r'sha256:(\w+)', rest))
        for name, version, rest in re.findall(r'^([\w.-]+)==(\S+) (.*)$', text, re.MULTILINE)
    }


def main() -> None:
    """Rewrite the file."""
    wanted, before = pins(), known()
    indexes = [*(setting('index-url') or [PyPI.simple_url]), *setting('extra-index-url')]
    files = [one for folder in setting('find-links') for one in beside(folder)]
    pages = [(index, name) for index in indexes for name in wanted]
    with ThreadPoolExecutor(8) as pool:
        for found in pool.map(lambda page: listed(*page), pages):
            files += found
    hashes = {pin: before.get(pin, set()) for pin in wanted.items()}
    for file, sha256 in files:
        pin = named(file)
        if pin in hashes and sha256:
            hashes[pin].add(sha256)
    if missing := [name for (name, _), found in hashes.items() if not found]:
        sys.exit(f'no index has {", ".join(missing)} at the version in {PINS.name}')
    HASHES.write_text(HEAD + ''.join(
        f'{name}=={version}' + ''.join(f' \\\n    --hash=sha256:{one}' for one in sorted(found))
        + '\n' for (name, version), found in hashes.items()
    ))


if __name__ == '__main__':
    main()
