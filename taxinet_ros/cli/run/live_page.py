"""``taxinet falsify --web``: the live page of a campaign, for browsers of this machine only.

It listens on 127.0.0.1, on a free port, at an address with a random token. It does nothing until it
is asked, and whatever happens in it ends no campaign.
"""

from __future__ import annotations

import contextlib
import hmac
import json
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

from rich.console import Console

from taxinet_ros.campaign.search import Search
from taxinet_ros.processes.interrupts import interrupts

ADDRESS = '127.0.0.1'
_TOKEN_BYTES = 24
_MOST_AT_ONCE = 8
_MOST_PAGES, _LONGEST_WORD = 64, 32
_SILENT_S = 10.0
_LOOKED_S = 6.0
"""A page asks every 2 s while somebody looks; one that has not for so long is closed or hidden."""
_LOOK_AGAIN_S = 0.05
_DATA = 'values.json'
_INTERRUPTED = 'was interrupted; the same command with --resume continues it'
_HTML, _JSON = 'text/html; charset=utf-8', 'application/json'


@contextlib.contextmanager
def live_page_of(search: Search) -> Iterator[None]:
    """Context in which the page of an open search is served; its address is printed once.

    If no server can be started, a line says why, and the campaign goes on without it.
    """
    # Standard error, so that --json and what --quiet leaves on standard output stay as they are.
    console = Console(stderr=True, highlight=False)
    try:
        server = LiveServer(*_page(search), lambda after: _values(search, after))
    except Exception as error:  # a page is no reason not to run a campaign
        console.print(f'--web: no page: {error}', soft_wrap=True, markup=False)
        yield
        return
    with server:
        console.print(f'live page: {server.address}', soft_wrap=True, markup=False)
        ended = 'was ended by an error, which the terminal names'
        try:
            yield
            ended = _end(search)
        except KeyboardInterrupt:
            ended = _INTERRUPTED
            raise
        finally:
            with interrupts(server.give_up):
                server.tell_end(lambda after: _values(search, after, ended))


def _page(search: Search) -> tuple[str, str]:
    from taxinet_ros.analysis.report.live import live_page

    options, campaign = search.options, search.options.campaign
    facts = {
        'program': campaign.program, 'network': Path(search.perception).name,
        'sampler': options.sampler, 'seed': str(campaign.seed),
        'folder': campaign.out.name, 'requirement': campaign.judging.headline,
    }
    title = f'{campaign.program}: searching for failures'
    return live_page(title, {name: word for name, word in facts.items() if word}, _DATA)


def _values(search: Search, after: int, ended: str = '') -> dict[str, Any]:
    from taxinet_ros.analysis.report.live import live_values

    return live_values(
        list(search.rows), search.first_planned, runs=search.options.runs, after=after, ended=ended)


def _end(search: Search) -> str:
    """How a search ended that was not ended by an error."""
    if search.interrupted and len(search.rows) < search.options.runs:
        return _INTERRUPTED
    return f'has ended: {search.stopped}' if search.stopped else 'has ended'


class LiveServer:
    """Serves one page and its values while it is open.

    Attributes:
        address: of the page; its token is the only way in, and is no part of any file.
    """

    def __init__(self, html: str, policy: str, values: Callable[[int], dict[str, Any]]) -> None:
        """Bind to a free port of this machine.

        Args:
            html: the page.
            policy: its content security policy.
            values: values of the rows after some number of them.

        Raises:
            OSError: there is no free port.
        """
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        self._server = _Server((ADDRESS, 0), _Handler)
        self._server.page, self._server.values = html.encode(), values
        self._server.root = f'/{token}/'
        self._server.headers = {**_HEADERS, 'Content-Security-Policy': policy}
        self.address = f'http://{ADDRESS}:{self._server.server_port}/{token}/'
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={'poll_interval': 0.2}, daemon=True,
            name='live-page',
        )

    def __enter__(self) -> LiveServer:
        self._thread.start()
        return self

    def tell_end(self, values: Callable[[int], dict[str, Any]]) -> None:
        """Serve the last values until every page that is being looked at has them.

        Waits for pages that have asked a moment ago, and not for long; for none if none has.

        Args:
            values: as before, now of the ended campaign.
        """
        self._server.end(values)

    def give_up(self) -> None:
        """Let :meth:`tell_end` wait no longer; safe to call from a signal handler."""
        self._server.given_up = True

    def __exit__(self, *_: object) -> None:
        """Close the port; answers that are under way are dropped."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


_HEADERS = {
    'Cache-Control': 'no-store', 'Referrer-Policy': 'no-referrer',
    'X-Content-Type-Options': 'nosniff', 'X-Frame-Options': 'DENY',
    'Cross-Origin-Resource-Policy': 'same-origin', 'Cross-Origin-Opener-Policy': 'same-origin',
}


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    page: bytes
    values: Callable[[int], dict[str, Any]]
    root: str
    headers: Mapping[str, str]

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.slots = threading.BoundedSemaphore(_MOST_AT_ONCE)
        self._lock = threading.Lock()
        self._asked: dict[str, float] = {}  # when a page has last asked, by its own word
        self._waited_for: set[str] = set()
        self.given_up = False

    def answered(self, page: str, values: Callable[[int], dict[str, Any]]) -> None:
        """Note that a page has got values of this source."""
        now = time.monotonic()
        with self._lock:
            if values is self.values:  # not those of before the end
                self._waited_for.discard(page)
            recent = {one: at for one, at in self._asked.items() if now - at < _LOOKED_S}
            if page and len(recent) < _MOST_PAGES:
                recent[page] = now
            self._asked = recent

    def end(self, values: Callable[[int], dict[str, Any]]) -> None:
        """Serve other values, and wait until the pages have them."""
        now = time.monotonic()
        with self._lock:
            self.values = values
            self._waited_for = {page for page, at in self._asked.items() if now - at < _LOOKED_S}
        while self._waited_for and not self.given_up and time.monotonic() < now + _LOOKED_S:
            time.sleep(_LOOK_AGAIN_S)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A broken request ends no campaign and prints nothing into its output."""


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = _SILENT_S
    server_version, sys_version = 'taxinet', ''

    def do_GET(self) -> None:
        """Answer for the page or its values; for nothing else, and for no other name of the host.

        A page of another site can have its name resolve to this machine (DNS rebinding), but the
        browser then tells that name.
        """
        if not self.server.slots.acquire(blocking=False):
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE)
            return
        try:
            self._get()
        finally:
            self.server.slots.release()

    def _get(self) -> None:
        hosts = self.headers.get_all('Host') or []
        if hosts != [f'{ADDRESS}:{self.server.server_port}']:
            self._answer(HTTPStatus.MISDIRECTED_REQUEST)
            return
        parts = urlsplit(self.path)
        path, root = parts.path.encode(), self.server.root.encode()
        if hmac.compare_digest(path, root):
            self._answer(HTTPStatus.OK, self.server.page, _HTML)
        elif hmac.compare_digest(path, root + _DATA.encode()):
            try:
                after, page = self._asked(parts.query)
                source = self.server.values
                values = json.dumps(source(after), allow_nan=False).encode()
            except Exception:  # the page says that there is no answer; the campaign goes on
                self._answer(HTTPStatus.INTERNAL_SERVER_ERROR)
                return
            self._answer(HTTPStatus.OK, values, _JSON)
            self.server.answered(page, source)
        else:
            self._answer(HTTPStatus.NOT_FOUND)

    def _asked(self, query: str) -> tuple[int, str]:
        """Number of the rows that a page has, and the page's own word."""
        asked = parse_qs(query)
        word, page = asked.get('after', ['0'])[0], asked.get('page', [''])[0]
        number = int(word) if word.isascii() and word.isdecimal() and len(word) < 10 else 0
        return number, page[:_LONGEST_WORD]

    def _answer(self, status: HTTPStatus, body: bytes = b'', kind: str = 'text/plain') -> None:
        self.send_response(status)
        for name, value in self.server.headers.items():
            self.send_header(name, value)
        self.send_header('Content-Type', kind)
        self.send_header('Content-Length', str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *words: object) -> None:
        """Print nothing: the terminal is the campaign's."""
