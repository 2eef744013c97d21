"""``taxinet odd``: cells, coverage and OpenODD, and the same from Python."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files

TABLE = Path(__file__).parents[3] / 'bags' / 's_falsif_generic_400.parquet'


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Drawing takes by far the longest; here only that it is done matters."""
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)


def test_given_a_shipped_odd_when_shown_then_cells_exclusions_and_counts_are_there(taxinet):
    code, said, _ = taxinet('odd', 's_falsif')
    assert code == 0
    assert 'rain         0 %, 25 to 50 %, 50 to 75 %, 75 to 100 %' in said
    assert 'excluded: clouds clear or cirrus or scattered, rain 25 to 100 % (no rain from' in said
    assert 'feasible: 29 cells, 339 pairs, 2,041 triples' in said
    told = json.loads(taxinet('odd', 's_falsif', '--json')[1])
    assert told['feasible'] == {'cells': 29, 'pairs': 339, 'triples': 2041}


@pytest.mark.nightly
def test_given_the_recorded_table_when_measured_then_the_numbers_are_those_of_the_docs(
    taxinet, tmp_path
):
    command = ('odd', 's_falsif', TABLE, '--below', 0.2)
    code, said, _ = taxinet(*command, '--plot', 'seen.png')
    assert code == 0
    assert '400 judged runs, 400 inside, 0 outside' in said
    assert '1200 to 1600 m        82      36  43.9 % (33.0–55.3 %)' in said
    assert 'pairs: 339 of 339 covered (100 %), 185 with a failure; 70 fail in less than' in said
    assert 'triples: 1,869 of 2,041 covered (91.5 %)' in said
    assert 'fill them: taxinet falsify PROGRAM --sampler coverage --odd s_falsif' in said
    assert (tmp_path / 'seen.png').read_bytes().startswith(b'\x89PNG')
    told = json.loads(taxinet(*command, '--json')[1])
    assert [one['covered'] for one in told['combinations']] == [29, 339, 1869]
    found = tx.odd_coverage(TABLE, 's_falsif', below=0.2)
    assert [one.below for one in found.strengths] == [
        one['below_limit'] for one in told['combinations']
    ]


def test_given_a_requirement_that_no_run_was_judged_by_then_one_line_says_so(taxinet):
    code, _, complaint = taxinet('odd', 's_falsif', TABLE, '--spec', 'psi')
    assert code == 2
    assert 'spec psi: not judged' in complaint


def test_given_an_odd_when_exported_then_both_files_are_there_and_none_is_overwritten(
    taxinet, tmp_path
):
    assert taxinet('odd', 's_falsif', '--out', 'out.yaml')[0] == 0
    written = yaml.safe_load((tmp_path / 'out.yaml').read_text())
    assert set(written) == {'TAXONOMY', 'MODULES'}
    binding = yaml.safe_load((tmp_path / 'out.binding.yaml').read_text())
    assert binding['openodd'] == ['out.yaml']
    code, _, complaint = taxinet('odd', 's_falsif', '--out', 'out.yaml')
    assert (code, 'already exists' in complaint) == (2, True)


def test_gaps_are_filled_with_everything_that_decided_the_runs_but_the_odds_own_parameters(
    taxinet,
):
    taxinet(
        'run', 'nominal', '--perception', 'truth', '--runs', '2', '--set', 'duration=0.2', '--set',
        'clouds=stratus', '--set', 'steering.heading_gain=0.5', '--spec', 'on_runway', '--set',
        'camera=nose', '--engine', 'loop', '--audit', '0', '--out', 'found',
    )
    said = taxinet('odd', 's_falsif', 'found')[1]
    assert said.partition('fill them: ')[2].splitlines()[0] == (
        'taxinet falsify nominal --sampler coverage --odd s_falsif --sampler-option strength=1 '
        "--perception truth --spec 'on_runway=always(abs(cte) <= 15.24)' --set duration_s=0.2 "
        '--set camera=nose --set steering.heading_gain=0.5'
    )
