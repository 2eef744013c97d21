"""A headless Chromium for tests of pages: one for each file of tests, without a network.

``TAXINET_CHROMIUM`` names the program; otherwise it is looked for on the path.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from waiting import PATIENT_S

CHROMIUM = os.environ.get('TAXINET_CHROMIUM') or next(
    filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome'))), None
)
WIDE, NARROW = {'width': 1280, 'height': 900}, {'width': 400, 'height': 800}


@pytest.fixture(scope='module')  # a process has one loop of playwright at a time
def browser() -> Iterator[Any]:
    """The browser; skips where there is none."""
    if CHROMIUM is None:
        pytest.skip('no chromium on the path; TAXINET_CHROMIUM may name one')
    api = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    flags = ['--disable-gpu', '--disable-background-networking', '--no-first-run']
    if os.geteuid() == 0:
        flags.append('--no-sandbox')  # Chromium refuses to have one as root.
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield chromium
        chromium.close()


@dataclass
class Opened:
    """A page in the browser, and what it did that it should not.

    Attributes:
        tab: playwright's page.
        complaints: what the console said.
        requests: addresses beyond the file and the data within it.
    """

    tab: Any
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def step(self) -> int:
        """The control step that the viewer shows."""
        return int(self.tab.locator('#viewer-scrubber').input_value())

    def wait_until(self, condition: str) -> None:
        """Wait for a JavaScript expression to be true, without `eval`, which the policy forbids."""
        self.tab.evaluate(f"""() => new Promise((done, late) => {{
            setTimeout(() => late(new Error('it was never so')), {1000 * PATIENT_S});
            const look = () => (({condition}) ? done() : requestAnimationFrame(look));
            look();
        }})""")

    def column(self, number: int) -> list[str]:
        """Cells of a column of the table, as shown."""
        return self.tab.locator(f'.table tbody td:nth-child({number})').all_inner_texts()


@contextmanager
def opened(
    browser: Any, path: Path, fragment: str = '', *, size: dict[str, int] = WIDE,
    colours: str = 'light',
) -> Iterator[Opened]:
    """Open a page and see to it that it neither complains nor asks for anything."""
    context = browser.new_context(viewport=size, color_scheme=colours, offline=True)
    page = Opened(context.new_page())
    page.tab.set_default_timeout(0)  # the suite has one
    page.tab.on('console', lambda message: page.complaints.append(message.text))
    page.tab.on('pageerror', lambda error: page.complaints.append(str(error)))
    page.tab.on('request', lambda request: page.requests.append(request.url))
    try:
        page.tab.goto(path.as_uri() + fragment)
        yield page
        beyond = [url for url in page.requests if not url.startswith(('data:', path.as_uri()))]
        assert (page.complaints, beyond) == ([], [])
    finally:
        context.close()
