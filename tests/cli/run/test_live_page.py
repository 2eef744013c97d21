"""``taxinet falsify --web``: the page of a campaign that runs, and who may see it."""

from __future__ import annotations

import http.client
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import pytest
from report_browser import browser
from taxinet_process import begun
from waiting import wait_for

from taxinet_ros.analysis.report.live import MOST_ROWS, live_page, live_values
from taxinet_ros.campaign.rates import rate
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import read_table
from taxinet_ros.cli.run.live_page import LiveServer
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome

__all__ = ['browser']


def row(index: int, outcome: Outcome, **changes: Any) -> RunRow:
    rho = {Outcome.PASS: {'phi': 0.5}, Outcome.FAIL: {'phi': -2.25 - index}}.get(outcome, {})
    values = {
        'run_id': f'run-{index}', 'index': index, 'program': 's_falsif', 'seed': 1,
        'perception': 'original', **Scenario().to_human(), 'sampler': 'random',
        'time_of_day_h': 8 + index / 4, 'distance_m': 100.0 * index, 'outcome': outcome,
        'robustness': exact_intervals(rho),
        'left_runway': outcome is Outcome.FAIL, **changes,
    }
    return RunRow(**values)


def rows(count: int) -> list[RunRow]:
    return [row(index, Outcome.FAIL if index % 4 == 3 else Outcome.PASS) for index in range(count)]


def asked(address: str, path: str | None = None, **headers: str) -> tuple[int, bytes]:
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.netloc, timeout=60)
    try:
        connection.request('GET', parts.path if path is None else path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


@contextmanager
def served(known: list[RunRow], runs: int = 40) -> Iterator[LiveServer]:
    html, policy = live_page('searching', {'program': 's_falsif'}, 'values.json')
    with LiveServer(
        html, policy, lambda after: live_values(list(known), range(runs), runs=runs, after=after)
    ) as server:
        yield server


def test_given_a_part_of_the_runs_then_the_rate_has_the_interval_that_holds_at_every_look() -> None:
    values = live_values(rows(20), range(40), runs=40, after=0)
    share = rate(5, 20, anytime=True)
    assert values['failing'] == (
        f'25.0 % ({100 * share.low:.1f}–{100 * share.high:.1f} %)')
    assert share.high - share.low > rate(5, 20).high - rate(5, 20).low
    assert (values['done'], values['judged'], values['failed']) == (20, 20, 5)
    assert values['lowest'] == -2.25 - 19


def test_given_rows_that_the_page_has_then_only_those_after_them_come() -> None:
    known = rows(10)
    values = live_values(known, None, runs=10, after=8)
    assert [one['id'] for one in values['rows']] == ['run-8', 'run-9']
    assert live_values(known, None, runs=10, after=10**6)['rows'] == []
    many = [known[0]] * (MOST_ROWS + 5)
    assert len(live_values(many, None, runs=10, after=0)['rows']) == MOST_ROWS


def test_given_no_run_or_one_without_a_verdict_then_nothing_is_claimed() -> None:
    values = live_values([], range(5), runs=5, after=0)
    assert (values['failing'], values['lowest'], values['rows']) == ('', None, [])
    broken = row(0, Outcome.INFRA_ERROR, kind='died', detail='exit code 7', left_runway=None)
    values = live_values([broken], range(5), runs=5, after=0)
    assert (values['judged'], values['without_verdict'], values['failing']) == (0, 1, '')
    assert values['rows'][0]['detail'] == 'exit code 7'
    json.dumps(values, allow_nan=False)


def test_given_the_address_then_it_is_this_machine_and_only_its_token_opens_it() -> None:
    with served(rows(4)) as server:
        assert server.address.startswith('http://127.0.0.1:')
        token = urlsplit(server.address).path
        assert len(token) > 30
        assert asked(server.address)[0] == 200
        assert json.loads(asked(server.address, f'{token}values.json?after=3')[1])['done'] == 4
        for path in ('/', '/values.json', token[:-1], token[:-2] + '/', f'{token}../', f'{token}x'):
            assert asked(server.address, path) == (404, b''), path
        for host in ('evil.example', 'localhost.evil.example', '127.0.0.1', 'localhost'):
            assert asked(server.address, Host=host) == (421, b''), host
        with served([]) as other:
            assert urlsplit(other.address).path != token


@pytest.mark.parametrize(
    'query', ['after=-1', 'after=x', f'after={"9" * 400}', 'after=%D9%A3', '&&='])
def test_given_a_query_that_is_no_number_then_all_rows_come(query: str) -> None:
    with served(rows(4)) as server:
        path = urlsplit(server.address).path
        status, body = asked(server.address, f'{path}values.json?{query}')
        assert (status, json.loads(body)['first']) == (200, 0)


def test_given_values_that_break_then_the_server_goes_on(
    capfd: pytest.CaptureFixture[str]
) -> None:
    def broken(after: int) -> dict[str, Any]:
        raise RuntimeError('a defect')

    with LiveServer('<p>page</p>', "default-src 'none'", broken) as server:
        assert asked(server.address, f'{urlsplit(server.address).path}values.json') == (500, b'')
        assert asked(server.address) == (200, b'<p>page</p>')
    assert capfd.readouterr() == ('', '')


def test_given_a_closed_server_then_nobody_listens() -> None:
    with served(rows(1)) as server:
        asked(server.address)
    with pytest.raises(ConnectionRefusedError):
        asked(server.address)


def test_given_a_browser_when_runs_end_then_figures_failures_and_map_follow(browser: Any) -> None:
    known = rows(12)
    with served(known) as server:
        tab = browser.new_page()
        complaints: list[str] = []
        tab.on('console', lambda message: complaints.append(message.text))
        tab.on('pageerror', lambda error: complaints.append(str(error)))
        tab.set_default_timeout(0)  # the suite has one
        tab.goto(server.address)
        tab.locator('#map .fail').first.wait_for()
        assert tab.locator('#map .fail').count() == 3
        assert tab.locator('#map .pass').count() == 9
        assert tab.locator('#failed').inner_text() == '3 of 12 judged'
        assert tab.locator('#failures td:first-child').all_inner_texts() == ['11', '7', '3']
        assert tab.locator('#failures td:nth-child(2)').first.inner_text() == '−13.25'
        assert tab.locator('#across').input_value() == 'time_of_day_h'
        assert tab.locator('#up').input_value() == 'distance_m'
        assert '08:00' in tab.locator('#map text').all_text_contents()
        assert tab.locator('a').count() == 0, 'it links to nothing that is not there'
        hostile = '<img src=x onerror="window.hacked = 1">'
        known += [row(12, Outcome.INFRA_ERROR, kind='died', detail=hostile, left_runway=None)]
        tab.locator('#failures tr').nth(3).wait_for()
        assert tab.locator('#failures td').nth(3).inner_text() == hostile
        assert tab.evaluate('window.hacked') is None
        assert complaints == []
        # The end is told, and the last figures stay.
    tab.get_by_text('The command no longer answers').wait_for()
    assert tab.locator('#failed').inner_text() == '3 of 12 judged'
    tab.close()


@pytest.mark.ros
def test_given_a_campaign_with_web_then_its_page_is_there_while_it_runs_and_its_rows_are_its_own(
    tmp_path: Any,
) -> None:
    out = tmp_path / 'found'
    words = (
        'falsify', 'nominal', '--runs', '3', '--perception', 'truth', '--set', 'duration=2',
        '--sampler', 'random', '--engine', 'loop', '--audit', '0', '--images', 'none', '--quiet',
        '--json', '--web', '--out', str(out), '--spec', 'near=always(abs(cte) <= 20)',
    )
    with open(tmp_path / 'stderr', 'wb') as stderr, begun(*words, stderr=stderr) as command:
        told = tmp_path / 'stderr'
        wait_for(lambda: re.search('live page: .*/\n', told.read_text()), told.read_text)
        address = re.findall('live page: (.*)\n', told.read_text())[0]
        path = f'{urlsplit(address).path}values.json'
        seen: dict[str, Any] = {}

        def look() -> bool:
            try:
                seen.update(json.loads(asked(address, path)[1]))
            except OSError:  # it has ended meanwhile
                return True
            return bool(seen['rows'])

        wait_for(look)
        command.wait()
    assert command.returncode == 0
    rho = read_table(out).set_index('run_id')['rho']
    assert all(one['rho'] == rho[one['id']] for one in seen['rows'])
    assert seen['runs'] == 3
    with pytest.raises(ConnectionRefusedError):
        asked(address)
