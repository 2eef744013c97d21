"""``taxinet falsify --web``: the page of a campaign that runs, and who may see it."""

from __future__ import annotations

import http.client
import json
import re
import shutil
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
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
from taxinet_ros.cli.run import live_page as served_page
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
    connection = http.client.HTTPConnection(parts.netloc)
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


def test_given_pages_that_are_looked_at_when_the_campaign_ends_then_it_waits_until_they_know(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(served_page, '_LOOKED_S', 3600.0)  # only the answers can end the waiting
    with served(rows(4)) as server:
        path = f'{urlsplit(server.address).path}values.json?page='
        for page in ('one', 'other'):
            assert json.loads(asked(server.address, path + page)[1])['ended'] == ''
        telling = threading.Thread(target=server.tell_end, args=[
            lambda after: live_values(rows(5), range(5), runs=5, after=after, ended='has ended')])
        telling.start()
        wait_for(lambda: json.loads(asked(server.address, path + 'one')[1])['ended'])
        assert telling.is_alive(), 'the other page does not know yet'
        last = json.loads(asked(server.address, path + 'other')[1])
        assert (last['ended'], last['done']) == ('has ended', 5)
        telling.join()


def test_given_nobody_who_looks_when_the_campaign_ends_then_nothing_is_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with served(rows(4)) as server:
        asked(server.address)
        asked(server.address, f'{urlsplit(server.address).path}values.json?page=gone')
        monkeypatch.setattr(served_page, '_LOOKED_S', 0.0)  # it was long ago
        server.tell_end(lambda after: {})


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
        # The command is gone without a word, and the last figures stay.
    tab.get_by_text('The command no longer answers').wait_for()
    assert tab.locator('#failed').inner_text() == '3 of 12 judged'
    tab.close()


def test_given_a_browser_when_the_campaign_ends_then_it_says_how_and_asks_no_more(
    browser: Any,
) -> None:
    with served(rows(3), runs=12) as server:
        tab = browser.new_page()
        tab.set_default_timeout(0)
        tab.goto(server.address)
        tab.get_by_text('3 of at most 12 runs have ended.').wait_for()
        telling = threading.Thread(target=server.tell_end, args=[
            lambda after: live_values(
                rows(4), None, runs=12, after=after, ended='was interrupted')])
        telling.start()
        tab.get_by_text('4 of at most 12 runs have ended. The campaign was interrupted.').wait_for()
        assert 'This page is closed' in tab.locator('#state').inner_text()
        assert tab.locator('#failures td:first-child').all_inner_texts() == ['3']
        telling.join()
        tab.close()


SEARCH = (
    'falsify', 'nominal', '--perception', 'truth', '--set', 'duration=2', '--sampler', 'random',
    '--engine', 'loop', '--audit', '0', '--images', 'none', '--quiet', '--json', '--web', '--spec',
    'near=always(abs(cte) <= 20)',
)


def watched(
    folder: Path, *words: str, when: Callable[[subprocess.Popen[str]], None] = lambda _: None,
) -> tuple[int, list[dict[str, Any]], str]:
    """A search to its end: exit code, the values that its page had, and its address.

    Args:
        folder: where standard error is kept.
        words: of the command, beside :data:`SEARCH`.
        when: called once, when the page has its first row.
    """
    told = folder / 'stderr'
    seen: list[dict[str, Any]] = []
    with told.open('wb') as stderr, begun(*SEARCH, *words, stderr=stderr) as command:
        wait_for(lambda: re.search('live page: .*/\n', told.read_text()), told.read_text)
        address = re.findall('live page: (.*)\n', told.read_text())[0]
        path = f'{urlsplit(address).path}values.json?page=test'

        def look() -> bool:
            seen.append(json.loads(asked(address, path)[1]))
            if seen[-1]['rows'] and not any(one['rows'] for one in seen[:-1]):
                when(command)
            return bool(seen[-1]['ended'])

        wait_for(look)
        command.wait()
    with pytest.raises(ConnectionRefusedError):
        asked(address)
    return command.returncode, seen, address


@pytest.mark.ros
def test_given_a_shard_with_web_then_its_page_has_its_rows_and_tells_its_end(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'found'
    code, seen, address = watched(
        tmp_path, '--runs', '6', '--shard', '2/2', '--out', str(out))
    assert code == 0
    assert seen[-1]['ended'] == 'has ended'
    assert (seen[-1]['done'], seen[-1]['runs']) == (3, 3)
    rho = read_table(out).set_index('run_id')['rho']
    assert {one['id']: one['rho'] for one in seen[-1]['rows']} == dict(rho)
    assert urlsplit(address).path not in ''.join(
        path.read_text(errors='replace') for path in out.rglob('*') if path.is_file())


@pytest.mark.ros
def test_given_ctrl_c_then_the_page_says_so_and_with_resume_it_begins_with_the_rows_of_before(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'found'
    code, seen, _ = watched(
        tmp_path, '--runs', '400', '--out', str(out),
        when=lambda command: command.send_signal(signal.SIGINT))
    assert code == 130
    assert seen[-1]['ended'] == 'was interrupted; the same command with --resume continues it'
    before = seen[-1]['done']
    assert 0 < before < 400
    code, seen, _ = watched(
        tmp_path, '--runs', '400', '--out', str(out), '--resume', '--budget', '0.001')
    assert code == 0
    assert seen[-1]['ended'] == 'has ended: the budget of 0.001 min is spent'
    assert [one['index'] for one in seen[-1]['rows']][:before] == list(range(before))


@pytest.mark.ros
def test_given_a_folder_that_is_lost_then_the_page_says_that_an_error_ended_the_campaign(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'found'
    code, seen, _ = watched(
        tmp_path, '--runs', '400', '--out', str(out), when=lambda _: shutil.rmtree(out))
    assert code == 4
    assert seen[-1]['ended'] == 'was ended by an error, which the terminal names'
