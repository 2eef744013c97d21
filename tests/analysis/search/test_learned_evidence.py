"""The failures on which a search's learned distribution rests, with their weights."""

from types import SimpleNamespace

import pytest

from taxinet_ros.analysis.search.learned import _evidence
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.samplers.space import Dimension

SEARCHED = tuple(
    SimpleNamespace(dimension=Dimension(name=name, buckets=2)) for name in ('x', 'rain')
)


def run(weight, *, x=0.1, refused=0, outcome=Outcome.FAIL, **point):
    return SimpleNamespace(outcome=outcome, weight=weight, refused=refused, point={'x': x, **point})


def search(*rows, sampler='ce', soft=False, **options):
    proposer = SimpleNamespace(
        space=SimpleNamespace(searched=SEARCHED, soft=soft), sampler=sampler,
        sampler_options=options,
    )
    return SimpleNamespace(rows=rows, proposer=proposer)


def test_given_failures_then_weights_and_their_squares_are_summed_by_bin():
    found = _evidence(search(
        run(2.0), run(0.5, x=0.7, rain=0.9), run(1.0, x=0.6), run(3.0, outcome=Outcome.PASS)))
    assert (found['x'].amounts, found['x'].squares) == ((2.0, 1.5), (4.0, 1.25))
    assert found['rain'].amounts == (0.0, 0.5), 'where it does not rain that choice is idle'
    assert found['x'].heaviest == pytest.approx(1 / 0.3)


def test_given_refused_points_then_their_runs_are_left_out_with_and_without_a_weight():
    """A weight of such a run would be wrong."""
    found = _evidence(search(run(2.0), run(None, refused=3), run(0.7, refused=1)))
    assert found['x'].amounts == (2.0, 0.0)


def test_given_weights_that_are_not_known_then_there_is_no_evidence():
    assert _evidence(search(run(1.0), run(None))) == {}
    assert _evidence(search(run(1.0), run(None, refused=2), soft=True)) == {}


@pytest.mark.parametrize(('sampler', 'options', 'heaviest'), [
    ('ce', {'rule': 'verifai'}, None), ('ce', {'rule': 'verifai', 'floor': 0.5}, 2.0),
    ('mab', {}, 10.0),
    ('mab', {'floor': '0.2'}, 5.0),
])
def test_given_a_share_of_draws_by_the_program_then_it_bounds_the_weights(
    sampler, options, heaviest
):
    assert _evidence(search(run(1.0), sampler=sampler, **options))['x'].heaviest == heaviest
