"""What ``taxinet run`` prints and ends with: ``--exit-zero``, ``--quiet``, ``--json``."""

from __future__ import annotations

import json

import pytest

SCENES = (
    'nominal', '--runs', '1', '--perception', 'truth', '--engine', 'loop', '--audit', '0',
    '--images', 'none', '--set', 'duration=0.5',
)
VIOLATED = ('--spec', 'fast=always(speed >= 7)')


@pytest.mark.parametrize(('command', 'words', 'code'), [
    ('run', (), 1), ('run', ('--exit-zero',), 0),
    ('falsify', ('--sampler', 'random', '--exit-zero'), 0),
])
def test_given_a_violated_run_then_exit_zero_alone_hides_it_from_the_exit_code(
    command, words, code, taxinet
):
    done, out, err = taxinet(command, *SCENES, *VIOLATED, *words, '--quiet', '--out', 'c')
    assert (done, err) == (code, '')
    assert '1 FAIL' in out


def test_given_exit_zero_when_something_else_is_wrong_then_it_hides_nothing(taxinet):
    assert taxinet('run', *SCENES, '--set', 'rain=200', '--exit-zero', '--out', 'c')[0] == 2


def test_given_quiet_then_the_summary_is_there_and_no_line_for_a_run(taxinet):
    loud = taxinet('run', *SCENES, '--out', 'loud')[1].splitlines()
    quiet = taxinet('run', *SCENES, '--quiet', '--out', 'quiet')[1].splitlines()
    (run,) = [line for line in loud if '  PASS  ' in line]
    assert run not in quiet
    assert '1 PASS' in quiet
    assert len(quiet) < len(loud)


def test_given_json_then_standard_output_is_that_and_nothing_else(taxinet):
    code, out, _ = taxinet('run', *SCENES, *VIOLATED, '--json', '--out', 'c')
    told = json.loads(out)
    assert code == 1
    assert told['outcomes']['FAIL'] == 1
