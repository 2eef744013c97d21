"""Searches that look before they run: sequence, resumption, and what cannot be looked at."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import falsify_samples as toy
import pandas as pd
import pytest

import taxinet_ros as tx
from taxinet_ros.campaign import search as search_module
from taxinet_ros.campaign.looks import Looker
from taxinet_ros.campaign.loop_run import Loop, LoopOptions
from taxinet_ros.campaign.options import make_options
from taxinet_ros.campaign.record.table import read_table
from taxinet_ros.campaign.search import search_summary
from taxinet_ros.core.pacing.timing import AT_ONCE
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.core.world import SimulatedWorld
from taxinet_ros.errors import UsageError

PER_MACHINE = ['bag', 'wall_s', 'real_time_factor']


@pytest.fixture
def looked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, Scenario]]:
    """Looks of the toy program, made by a formula; each is noted."""
    made: list[tuple[int, Scenario]] = []

    def look(self: Looker, index: int, scenario: Scenario) -> float:
        made.append((index, scenario))
        return math.hypot(scenario.cross_track_m + 4, scenario.distance_m / 500 - 3) - 1.9

    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)
    monkeypatch.setattr(Looker, 'look', look)
    return made


def asked(out: Path, **changes):
    return toy.options(out, runs=24, sampler='screening', perception='taxinet', **changes)


def test_given_answers_in_any_order_then_the_table_is_that_of_one_worker(looked, tmp_path):
    done = toy.finish(asked(tmp_path / 'one'))
    alone = list(looked)
    looked.clear()
    toy.finish(asked(tmp_path / 'many', workers=3), 3, toy.last)
    toy.same_table(tmp_path / 'one', tmp_path / 'many')
    assert looked == alone
    table = read_table(tmp_path / 'one')
    assert list(table['drawn']) == [index % 4 == 3 for index in range(24)]
    assert table['weight'].isna().all()
    assert (table['rho'] <= 0).sum() >= 8
    assert done.screening.looks == len(alone)
    [line] = [line for line in search_summary(done) if 'looks at scenes' in line]
    assert line.startswith(f'{len(alone)} looks at scenes chose ')


def test_given_a_kill_when_resumed_then_the_table_is_that_of_an_undisturbed_search(
    looked, tmp_path
):
    toy.finish(asked(tmp_path / 'whole'))
    with toy.searching(asked(tmp_path / 'killed')) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last)):
            if number == 13:
                break
    toy.finish(asked(tmp_path / 'killed', resume=True))
    toy.same_table(tmp_path / 'whole', tmp_path / 'killed')


@pytest.mark.parametrize(('changes', 'message'), [
    ({'perception': 'truth'}, 'a look spares pictures, and perception truth needs none'),
    ({'perception': ''}, 'not with that of a standing graph'),
    ({'perception': 'cmd:./look'}, 'the perception cmd:./look is one'),
    ({'cluster': 'local:2'}, 'would keep a --cluster waiting'),
])
def test_given_what_cannot_be_looked_at_then_it_is_refused_in_one_line(
    changes, message, looked, tmp_path
):
    options = toy.options(tmp_path / 'out', sampler='screening', **{
        'perception': 'taxinet', **changes,
    })
    with pytest.raises(UsageError, match='--sampler screening: ') as caught, \
            toy.searching(options):
        pass
    assert message in str(caught.value)
    assert str(caught.value).endswith('; use --sampler active')
    assert '\n' not in str(caught.value)


def test_given_functions_that_looks_tell_nothing_about_then_the_loop_refuses_them(tmp_path):
    blind = tmp_path / 'mine.py'
    blind.write_text(
        'class Known:\n    needs_image = False\n\n'
        '    def __call__(self, truth):\n        return truth\n'
    )
    with pytest.raises(UsageError, match='looks spare pictures, and perception python needs none'):
        Loop(LoopOptions(
            perception=f'{blind}:Known', controller='steering', controller_sha256='', gains={},
            timing=AT_ONCE, world='kmwh', world_sha256='', out=None, images='none', every=10,
        ))


def test_given_a_world_with_something_to_give_back_then_it_is_closed_after_every_run(tmp_path):
    closed = []

    class Closing(SimulatedWorld):
        def close(self) -> None:
            closed.append(self)

    loop = Loop(LoopOptions(
        perception='truth', controller='steering', controller_sha256='', gains={},
        timing=AT_ONCE, world='kmwh', world_sha256='', out=None, images='none',
    ))
    loop._world = dataclasses.replace(loop._world, make=Closing)
    for number in range(2):
        loop.run(RunRequest(
            run_id='one', index=0, program='', seed=0, scenario=Scenario(duration_s=1.0),
            judging=Judging(specs=('phi_always',)), participants=(),
        ))
        assert len(closed) == number + 1


def test_given_looks_that_break_then_the_search_ends_with_the_reason(tmp_path):
    (tmp_path / 'broken.py').write_text('def look(image):\n    raise ValueError("no light")\n')
    campaign = make_options(
        program='nominal', runs=1, seed=0, perception=f'{tmp_path}/broken.py:look', settings=(),
        specs=(), out=tmp_path / 'out', processes=False,
    )
    campaign.out.mkdir()
    with Looker(campaign, lambda: {'controller_sha256': ''}, 10) as looker:
        scene = Scenario(duration_s=1.0)
        assert [looker.look(0, scene) for _ in range(2)] == [None, None]
        with pytest.raises(UsageError, match=r'3 looks in a row broke.*no light'):
            looker.look(0, scene)


def test_given_a_network_then_real_looks_choose_the_same_scenes_with_two_workers(tmp_path):
    def found(workers: int) -> pd.DataFrame:
        tx.falsify(
            's_falsif', runs=5, sampler='screening', sampler_options={'looks': 2, 'every': 5},
            perception='original', specs='phi_always', settings={'duration': 1}, seed=4,
            workers=workers, out=tmp_path / str(workers),
        )
        return read_table(tmp_path / str(workers)).drop(columns=PER_MACHINE)

    one = found(1)
    pd.testing.assert_frame_equal(one, found(2))
    assert len(one) == 5
    assert list(one['sampler'].unique()) == ['screening']
    assert (tmp_path / '1' / 'logs' / 'looks').is_dir()
