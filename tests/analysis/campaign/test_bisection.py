"""Bisection over networks in order: exact per scene, with as few runs as that takes."""

import itertools
import math

from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.analysis.campaign.bisection import (
    bisect_scenes,
    bisection_json,
    bisection_text,
)

TABLES = st.integers(2, 9).flatmap(lambda networks: st.lists(
    st.lists(st.booleans(), min_size=networks, max_size=networks), min_size=1, max_size=6))


class Bench:
    """Knows the result of every network in every scene, and counts what it is asked."""

    def __init__(self, table) -> None:
        self.table, self.asked = table, []

    def drive(self, place, names):
        self.asked += [(place, name) for name in names]
        return {name: self.table[int(name)][place] for name in names}


def bisect(table, **options):
    bench = Bench(table)
    networks = [f'n{place}' for place in range(len(table[0]))]
    found = bisect_scenes(networks, [str(number) for number in range(len(table))], bench.drive,
                          **options)
    return found, bench


@given(TABLES)
def test_a_scene_that_breaks_is_broken_by_a_network_beside_one_that_satisfied_it(table):
    found, bench = bisect(table)
    assert len(bench.asked) == len(set(bench.asked)) == found.runs
    most = 2 + math.ceil(math.log2(max(len(table[0]) - 1, 1)))
    every, _ = bisect(table, every=True)
    assert every.runs == len(table) * len(table[0])
    for scene, all_of_it, truth in zip(found.scenes, every.scenes, table, strict=True):
        broken, fixed = (
            tuple(place for place, pair in enumerate(itertools.pairwise(truth), 1) if pair == kind)
            for kind in ((True, False), (False, True))
        )
        assert (all_of_it.broken, all_of_it.fixed) == (broken, fixed)
        assert len(scene.results) <= most
        assert scene.broken or not truth[0] or truth[-1]
        assert set(scene.broken) <= set(broken)
        assert set(scene.fixed) <= set(fixed)


def test_each_scene_is_blamed_on_its_own_network():
    found, bench = bisect([
        [True, True, False, False, False], [True, True, True, True, False],
        [True, True, True, True, True], [False, False, False, False, False],
    ])
    assert (found.broken_by(2), found.broken_by(4)) == (('0',), ('1',))
    assert len(bench.asked) == 2 * 4 + 2 + 2
    assert bisection_json(found)['broken'] == {'n1': [], 'n2': ['0'], 'n3': [], 'n4': ['1']}
    first, *lines = bisection_text(found).splitlines()
    assert first.startswith(
        '4 scenes (12 runs): 2 satisfied by n0 and violated by n4, 0 the other way round')
    assert 'n2 breaks 1 scene that n1 satisfied: 0' in lines


def test_a_run_without_a_verdict_is_unclear_and_blames_nobody():
    found, _ = bisect([[True, None, False]])
    (scene,) = found.scenes
    assert (scene.broken, scene.unclear) == ((), True)
    assert 'not judged with some network, so unclear: 0' in bisection_text(found)
