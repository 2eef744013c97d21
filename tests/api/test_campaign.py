"""``tx.open_campaign``: rows, counterexamples and rates of a folder."""

from __future__ import annotations

import pytest

import taxinet_ros as tx


def test_given_a_campaign_then_its_rows_and_failures_are_those_of_the_record(campaign_folder):
    campaign = tx.open_campaign(str(campaign_folder))
    assert campaign.rows['run_id'].tolist() == ['run-0', 'run-1', 'run-2']
    assert campaign.rows['outcome'].tolist() == ['PASS', 'FAIL', 'PASS']
    assert campaign.facts['perception'] == 'truth'
    [failed] = campaign.counterexamples
    assert failed.run_id == 'run-1'
    assert failed.bag is None
    assert failed.scenario == tx.Scenario(cross_track_m=7.0, duration_s=2.0)
    lower, upper = failed.headline
    assert lower == upper == campaign.rows['rho'][1] < -5
    assert failed.rho == {'phi_always': failed.headline}


def test_given_a_campaign_then_its_rates_are_those_of_its_program(campaign_folder):
    rates = tx.open_campaign(campaign_folder).rates
    assert list(rates) == ['failed', 'off_runway']
    failed = rates['failed']
    assert (failed.hits, failed.runs, failed.anytime) == (1, 3, False)
    assert failed.rate is not None
    assert failed.rate.low < failed.rate.rate == 1 / 3 < failed.rate.high
    assert (failed.low, failed.value, failed.high) == (
        failed.rate.low, failed.rate.rate, failed.rate.high)


@pytest.mark.nightly
def test_given_a_campaign_in_a_notebook_then_it_is_short_and_draws_itself(campaign_folder):
    campaign = tx.open_campaign(campaign_folder)
    assert repr(campaign).endswith(': 3 runs, 1 failed>')
    assert repr(campaign.counterexamples[0]).startswith('<Counterexample run-1: phi_always rho -5.')
    assert '33.3% [0.8%, 90.6%] of 3 runs' in campaign._repr_html_()
    assert campaign.plot()._repr_png_().startswith(b'\x89PNG')
    page = campaign.report()
    assert page == campaign_folder / 'analysis' / 'report.html'
    assert 'violate phi_always' in page.read_text()


def test_given_a_folder_that_is_no_campaign_then_one_line_says_so(tmp_path):
    with pytest.raises(tx.UsageError, match=r'not a campaign: no campaign\.db'):
        tx.open_campaign(tmp_path)
