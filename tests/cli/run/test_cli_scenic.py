"""Scenic programs that are refused leave nothing behind, whichever command was to use them."""

from __future__ import annotations

import pytest

REFUSED = 'model runway_world\nego = new Plane at (0, 400)\nrecord ego.position\n'


@pytest.mark.parametrize('words', [
    ('run', '--perception', 'truth'), ('falsify', '--perception', 'truth'),
    ('dataset', '--count', '2'),
])
def test_s5_a_refused_program_leaves_no_folder_behind(words, taxinet, tmp_path):
    (tmp_path / 'mine.scenic').write_text(REFUSED)
    command, *options = words
    code, out, err = taxinet(command, 'mine.scenic', '--out', 'out', *options)
    assert code == 2
    assert out == ''
    (line,) = err.splitlines()
    assert line == (
        'taxinet: error: mine.scenic:3: record has no effect here: the bag of a run holds all of '
        'it; leave it out'
    )
    assert [path.name for path in tmp_path.iterdir()] == ['mine.scenic']


def test_s4_a_dataset_says_that_it_draws_without_the_programs_sampler(taxinet, tmp_path):
    (tmp_path / 'mine.scenic').write_text(
        'model runway_world\nparam verifaiSamplerType = "halton"\n'
        'ego = new Plane at (VerifaiRange(-1, 1), 400)\n'
    )
    words = ('dataset', 'mine.scenic', '--count', '1', '--workers', '1')
    code, _, err = taxinet(*words, '--out', 'drawn')
    assert (code, err) == (0, (
        'scenes are drawn as the program has them, without a sampler: '
        "verifaiSamplerType = 'halton' of mine.scenic:2 is for taxinet falsify\n"
    ))
    assert taxinet(*words, '--out', 'spread', '--sampler', 'halton')[2] == ''
