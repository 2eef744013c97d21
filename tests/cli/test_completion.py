"""TAB: what bash, zsh and fish are told, and what each offers behind it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from taxinet_ros.cli.completion import (
    answer_shell,
    complete_fallback,
    complete_perception,
    complete_program,
    complete_renderer,
    complete_sampler,
    complete_setting,
)
from taxinet_ros.cli.main import app
from taxinet_ros.core.scenario_fields import BY_KEY, HUMAN_KEYS, SHORT_FORMS, Kind

TAXINET = Path(sys.executable).with_name('taxinet')
CLOUDS = ['clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus']


def test_given_the_beginning_of_a_word_when_completed_then_all_that_fit_are_offered():
    assert set(complete_program('s_falsif')) >= {'s_falsif', 's_falsif_ce'}
    assert complete_perception('tax') == ['taxinet']
    assert complete_sampler('ce') == ['ce']
    assert complete_renderer('') == ['ours', 'flightgear', 'xplane']
    assert complete_fallback('s') == [
        'stop', 'slow', *(f'second:{name}' for name in complete_perception('')),
    ]


def test_given_a_setting_then_keys_are_offered_and_behind_them_values_that_are_words():
    assert complete_setting('') == [f'{key}=' for key in (*HUMAN_KEYS, *SHORT_FORMS)]
    assert complete_setting('time') == ['time_of_day_h=', 'time_of_day=']
    assert complete_setting('clouds=s') == ['clouds=scattered', 'clouds=stratus']
    assert complete_setting('crossing=') == ['crossing=on', 'crossing=off']
    assert complete_setting('aircraft=c17') == ['aircraft=c172p']
    assert complete_setting('steering.h') == ['steering.heading_gain=']
    assert complete_setting('fog=') == complete_setting('fog') == complete_setting('rain=3') == []


def test_given_a_single_key_then_its_values_come_along_so_that_no_space_does():
    assert complete_setting('clo') == [f'clouds={word}' for word in CLOUDS]


def test_given_any_key_with_a_closed_set_of_values_then_a_scenario_takes_each_that_is_offered():
    closed = [
        key for key in HUMAN_KEYS
        if BY_KEY[key].words or BY_KEY[key].catalogue or BY_KEY[key].kind is Kind.SWITCH
    ]
    assert len(closed) >= 7
    for key in closed:
        offered = complete_setting(f'{key}=')
        assert len(offered) >= 1
        for word in offered:
            BY_KEY[key].settled(word.partition('=')[2])


def asked(monkeypatch, capfd, **environment):
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    code = answer_shell(lambda: app.built(standalone_mode=False, prog_name='taxinet'), os.environ)
    assert code in (0, None)
    return capfd.readouterr().out.splitlines()


@pytest.mark.parametrize(('typed', 'place', 'offered'), [
    # typed: the words as bash breaks them; its word to complete is replaced by what is offered
    ('taxinet|fals', 1, ['falsify']),
    ('taxinet|run|s_falsif|--set|clou', 4, [f'clouds={word}' for word in CLOUDS]),
    ('taxinet|run|s_falsif|--set|clouds|=', 5, CLOUDS),
    ('taxinet|run|s_falsif|--set|clouds|=|s', 6, ['scattered', 'stratus']),
    ('taxinet|run|--set|=|clouds|=|s', 6, ['scattered', 'stratus']),
    ('taxinet|run|--set|crossing|=|o', 5, ['on', 'off']),
    ('taxinet|run|--set|clouds|=|clear|--set|place|=|kmwh', 9, ['kmwh_04']),
    ('taxinet|run|--fallback|second|:|tax', 5, ['taxinet']),
    ('taxinet|run|--perception|my.py|:|loo', 5, []),
    ('taxinet|run|s_falsif|--engine|', 4, ['graph', 'loop']),
    ('taxinet|run|s_falsif|--perception|=|tru', 5, ['truth']),
    ('taxinet|frame|--set|clouds|=|ci', 5, ['cirrus']),
    ('taxinet|fork|RUN|--set|runway_state|=|i', 6, ['icy']),
    ('taxinet|falsify|s_falsif|--sampler|ce|--sampler-option|fl', 6, ['floor=']),
    ('taxinet|falsify|s_falsif|--bound|ct', 4, ['cte=', 'cte_estimate=', 'cte_sigma=']),
])
def test_given_bash_when_it_asks_then_it_gets_what_replaces_its_piece_of_the_word(
    typed, place, offered, monkeypatch, capfd
):
    assert asked(
        monkeypatch, capfd, _TAXINET_COMPLETE='complete_bash',
        COMP_WORDS=typed.replace('|', '\n'), COMP_CWORD=str(place),
    ) == offered


@pytest.mark.parametrize(('shell', 'more', 'line'), [
    ('zsh', {}, '"clouds=stratus"'),
    ('fish', {'_TYPER_COMPLETE_FISH_ACTION': 'get-args'}, 'clouds=stratus'),
])
def test_given_another_shell_when_it_asks_then_it_gets_the_whole_word(
    shell, more, line, monkeypatch, capfd
):
    told = asked(
        monkeypatch, capfd, _TAXINET_COMPLETE=f'complete_{shell}',
        _TYPER_COMPLETE_ARGS='taxinet run s_falsif --set clouds=st', **more,
    )
    assert len(told) == 1
    assert line in told[0]


@pytest.mark.parametrize('word', ['bogus', 'complete_bogus', 'source_bogus'])
def test_given_a_shell_that_is_not_known_when_it_asks_then_that_is_bad_input(word):
    done = subprocess.run(
        [TAXINET], env={**os.environ, '_TAXINET_COMPLETE': word}, capture_output=True, text=True,
        check=False,
    )
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(('words', 'environment', 'told'), [
    (['--show-completion'], {'_TAXINET_COMPLETE_TEST_DISABLE_SHELL_DETECTION': '1'}, ''),
    ([], {'_TAXINET_COMPLETE': 'source_zsh'}, '_taxinet_completion'),
])
def test_given_a_shell_that_asks_when_completed_then_nothing_else_is_printed(
    words, environment, told
):
    done = subprocess.run(
        [TAXINET, *words], env={**os.environ, **environment}, capture_output=True, text=True,
        check=False,
    )
    assert told in done.stdout
    assert 'taxinet: error' not in done.stderr


def test_given_bash_itself_with_the_shipped_script_when_it_completes_then_values_are_there():
    words = '--set clouds = s'
    script = f"""
        eval "$(_TAXINET_COMPLETE=source_bash taxinet)"
        COMP_WORDS=(taxinet run s_falsif {words}); COMP_CWORD=6
        _taxinet_completion taxinet
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    path = f'{TAXINET.parent}{os.pathsep}{os.environ["PATH"]}'
    done = subprocess.run(
        ['bash', '-c', script], env={**os.environ, 'PATH': path}, capture_output=True, text=True,
        check=True,
    )
    assert done.stdout.split() == ['scattered', 'stratus'], done.stderr
