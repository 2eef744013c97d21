"""A graph has a ROS domain that nobody else on the machine uses."""

from __future__ import annotations

import itertools
import os
import socket

import pytest

from taxinet_ros.cli.main import app
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.running import domain
from taxinet_ros.nodes.running.domain import BY_HAND, own_domain

pytestmark = pytest.mark.ros


@pytest.mark.parametrize('text', ['233', '-1', 'abc', '1.5', '²'])
def test_given_a_domain_by_hand_that_is_none_then_one_line_says_what_is(text, monkeypatch):
    monkeypatch.setenv(BY_HAND, text)
    with pytest.raises(UsageError, match=r'TAXINET_DOMAIN_ID .*: a ROS domain is .* 0 to 232'):
        own_domain().__enter__()


def test_given_graphs_that_reserve_then_no_two_have_the_same_domain():
    with own_domain() as first, own_domain() as second, own_domain() as third:
        assert len({first, second, third}) == 3


def test_given_a_domain_by_hand_that_another_graph_has_reserved_then_one_line_says_so(monkeypatch):
    with own_domain() as number:
        monkeypatch.setenv(BY_HAND, str(number))
        with pytest.raises(UsageError, match=rf'^ROS domain {number} is taken: another graph'):
            own_domain().__enter__()


@pytest.mark.parametrize('words', [
    ('falsify', 'nominal', '--out', 'new'), ('experiment', 'crossing', '--out', 'new'),
    ('case-study', '--scale', '0.02', '--out', 'new'),
])
def test_t17_domain_by_hand_takes_one_worker_and_nothing_is_written(words, tmp_path, monkeypatch):
    monkeypatch.setenv(BY_HAND, '77')
    monkeypatch.chdir(tmp_path)
    message = 'TAXINET_DOMAIN_ID 77: a single domain, but 2 workers need one each; use'
    with pytest.raises(UsageError, match=message):
        app([*words, '--workers', '2'], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []


def test_t17_domain_by_hand_that_is_none_is_refused_before_a_search_begins(tmp_path, monkeypatch):
    monkeypatch.setenv(BY_HAND, 'banana')
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="TAXINET_DOMAIN_ID 'banana': a ROS domain is an integer"):
        app(['falsify', 'nominal', '--out', 'new'], standalone_mode=False)
    assert list(tmp_path.iterdir()) == []


def first_choice(number: int, monkeypatch) -> None:
    """Have graphs try one domain first, and then the others in turn."""
    monkeypatch.setattr(domain, '_graphs', itertools.count(number - 1 - os.getpid()))


def test_given_a_fork_of_this_process_then_it_begins_its_search_elsewhere(monkeypatch):
    found = []
    for process in (os.getpid(), os.getpid() + 50):
        monkeypatch.setattr(os, 'getpid', lambda process=process: process)
        monkeypatch.setattr(domain, '_graphs', itertools.count())
        with own_domain() as number:
            found.append(number)
    assert found[0] != found[1]


def test_f5_given_a_port_of_dds_that_another_program_has_then_that_domain_is_passed_over(
    monkeypatch
):
    with own_domain() as number:
        pass
    first_choice(number, monkeypatch)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(('127.0.0.1', 7400 + 250 * number + 14))
        with own_domain() as other:
            assert other != number


def test_f5_given_all_domains_in_use_then_one_line_says_so(monkeypatch):
    monkeypatch.setattr(domain, 'in_use', lambda number: True)
    with pytest.raises(UsageError, match='all ROS domains from 1 to 100 are in use; end a graph'):
        own_domain().__enter__()
