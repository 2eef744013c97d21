"""A disk that is full: the run says so, what was recorded is sound, the campaign does not go on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from command_process import ended, small_disk, taxinet
from graph_runs import request, run, steps_in

from taxinet_ros.bag.rewrite.recovery import recover
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import RECORDER

pytestmark = [pytest.mark.nightly, pytest.mark.ros]


class NothingKeptFree(GraphOptions):
    """A recorder that begins on a disk however small."""

    def nodes(self):
        kind, parameters = super().nodes()[RECORDER]
        return {**super().nodes(), RECORDER: (kind, {**parameters, 'min_free': 0})}


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk with room for 600 kB, or for so many frames."""
    with small_disk(tmp_path / 'disk', '600k') as place:
        yield place


def test_given_a_disk_that_fills_up_then_the_run_is_broken_and_its_bag_can_be_saved(
    disk, tmp_path
):
    with composed_graph(NothingKeptFree(perception='truth', out=disk)) as graph:
        (full,) = run(graph, request('full', 60.0))
        assert (full.outcome, full.kind, full.who) == (Outcome.INFRA_ERROR, 'bag', RECORDER)
        assert f'{disk}/full/full_0.mcap: cannot write: [Errno 28] No space left on device' in (
            full.detail
        )
        assert full.rho == {}
        steps = steps_in(disk / 'full')
        assert len(steps) > 2
        assert steps == list(range(len(steps)))
        assert not (disk / 'full' / 'metadata.yaml').exists(), 'it is not declared whole'
        recover(disk / 'full', tmp_path / 'saved')
        assert steps_in(tmp_path / 'saved') == steps
        (disk / 'full' / 'full_0.mcap').unlink()
        (after,) = run(graph, request('after', 0.1))
    assert after.outcome.judged, 'there is room again'


def test_given_too_little_space_when_a_campaign_would_begin_then_one_line_says_so_before(
    disk, tmp_path
):
    words = ('run', 'nominal', '--runs', '6', '--perception', 'truth', '--images', 'none',
             '--set', 'duration=1', '--out', str(disk / 'c'))
    with taxinet(*words, cwd=tmp_path) as campaign:
        code, out, err = ended(campaign)
    assert (code, out) == (2, '')
    assert err == (
        f'taxinet: error: {disk}: 0.001 GB free on the disk, 1.000 GB wanted; make room or record '
        'elsewhere\n'
    )
    assert not (disk / 'c').exists()
