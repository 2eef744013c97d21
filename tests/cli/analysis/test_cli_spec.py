"""``taxinet spec``: requirements looked at without a run."""

from __future__ import annotations

import json

import pytest

from taxinet_ros.cli.main import _exit_code, app


def call(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = _exit_code(lambda: app(['spec', *words], standalone_mode=False))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_people2_given_requirements_then_each_is_told_as_understood_and_warned_of(capsys) -> None:
    words = ['phi_eventually', 'gentle=always(abs(steering) <= 0.3)']
    code, out, err = call(capsys, *words)
    assert (code, err) == (0, '')
    assert out.splitlines() == [
        'phi_eventually: within 1.5 m of the centreline from 10 s at the latest to the end; '
        'cte within ±240 m; horizon 30 s',
        'gentle: |steering| <= 0.3 rad (17.19 deg) all the time; '
        'steering within ±0.261799 rad (15 deg); horizon 30 s',
        'warning: gentle: no run can violate it: |steering| <= 0.3 rad (17.19 deg) always holds '
        '(steering within ±0.261799 rad (15 deg))',
    ]
    found = json.loads(call(capsys, *words, '--json')[1])
    assert [one['spec'] for one in found['specs']] == ['phi_eventually', 'gentle']
    assert [f'warning: {line}' for line in found['warnings']] == out.splitlines()[2:]


def test_people2_given_the_controllers_gains_and_a_length_then_they_count(capsys) -> None:
    code, out, _ = call(
        capsys, 'gentle=always(abs(steering) <= 0.3)', '--set', 'steering.max_steering_rad=0.5',
        '--duration', '12',
    )
    assert code == 0
    assert out == (
        'gentle: |steering| <= 0.3 rad (17.19 deg) all the time; '
        'steering within ±0.5 rad (28.65 deg); horizon 12 s\n'
    )


def test_given_a_control_rate_then_windows_are_those_of_its_steps(capsys) -> None:
    words = 'soon=eventually[0.05:0.05](abs(cte) < 1)', '--set', 'control_rate_hz=20'
    assert call(capsys, *words)[0] == 0
    assert call(capsys, words[0])[0] == 2


@pytest.mark.parametrize(('words', 'complaint'), [
    (['far=always[35:40](cte < 1)'], 'spec far: always[35:40] begins 35 s into the run, which'),
    (['abs(he) <= 10 m'], 'column 12: expected an angle'),
    (['phi_always', '--set', 'rain=3'],
     '--set rain_percent: only controller gains and control_rate_hz apply here'),
    (['phi_always', '--set', 'control_rate_hz=7'], 'control_rate_hz'),
    (['phi_always', '--duration', '0'], 'duration_s is 0, outside 0.1..600 s'),
])
def test_people2_given_what_cannot_be_judged_then_one_line_says_why(
    capsys, words: list[str], complaint: str
) -> None:
    code, out, err = call(capsys, *words)
    assert (code, out) == (2, '')
    assert complaint in err
    assert len(err.splitlines()) == 1
