"""A world that a package brings, in a whole graph: its bag tells, and is not driven in another."""

from __future__ import annotations

import sys

import pytest
from graph_runs import judged_in, run_in
from plugins import lay_down

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.main import main
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph

pytestmark = pytest.mark.ros


CODE = """
from functools import partial
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.rig.catalogue import find_aircraft
from taxinet_ros.core.world import SimulatedWorld

LIGHT = partial(SimulatedWorld, aircraft=partial(Aircraft, model=find_aircraft('c172p')))
"""


def test_given_a_world_of_a_package_when_a_graph_runs_in_it_then_its_bag_tells_and_needs_it(
    tmp_path, monkeypatch, short_request: RunRequest, capfd
):
    site = tmp_path / 'site'
    with monkeypatch.context() as installed:
        installed.syspath_prepend(str(site))
        lay_down(site, 'light-world', CODE, worlds='light = LIGHT')
        options = GraphOptions(
            perception='truth', out=tmp_path, images='none', world='light',
        )
        judged_in(composed_graph(options), short_request)
        bag = tmp_path / short_request.run_id
        told = open_recording(bag).run
        assert (told.world, len(told.world_fingerprint)) == ('light', 64)
        # Compares every state with the bag's, to the bit; a Cessna stands lower than a Caravan.
        driven = list(open_recording(bag).observations(lambda seq: False))
        assert len(driven) == 21
        assert driven[0].state.z_m < 1.4
        (site / 'light_world.py').write_text(f'{CODE}# changed\n')
        with pytest.raises(UsageError, match=r'world light is .* now, it was'):
            next(open_recording(bag).observations())
    with pytest.raises(UsageError, match="world: 'light' is unknown; known: kmwh"):
        next(open_recording(bag).observations())
    monkeypatch.setattr(sys, 'argv', ['taxinet', 'run', '--from', str(bag)])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert "world: 'light' is unknown" in capfd.readouterr().err


BLIND = """
import dataclasses
from taxinet_ros.core.world import SimulatedWorld

class Blind(SimulatedWorld):
    def observe(self, *, picture=True):
        return dataclasses.replace(super().observe(picture=picture), image=None)
"""


@pytest.mark.parametrize(('perception', 'images', 'blamed'), [
    ('truth', 'none', ''), ('original', 'none', 'perception'), ('truth', 'all', 'recorder'),
])
def test_given_a_world_without_pictures_when_a_network_is_to_see_then_the_run_says_so_at_once(
    tmp_path, monkeypatch, short_request: RunRequest, perception: str, images: str, blamed: str,
):
    site = tmp_path / 'site'
    monkeypatch.syspath_prepend(str(site))
    lay_down(site, 'blind-world', BLIND, worlds='blind = Blind')
    options = GraphOptions(perception=perception, out=tmp_path, images=images, world='blind')
    (found,) = run_in(composed_graph(options), short_request)
    assert found.outcome.judged is not bool(blamed)
    detail = f'the world has no picture, which {blamed} needs'
    assert (found.kind, found.detail) == (('sim', detail) if blamed else ('', ''))
