"""What the docs say of the paper's statements is what the shipped tables say."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

import taxinet_ros as tx
from taxinet_ros.bag.check.compare import same_stack
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.source import SceneSource
from taxinet_ros.study.report.claim import Claim, Verdict, p_words
from taxinet_ros.study.report.report import gather_findings, report_case_study
from taxinet_ros.study.report.results import LEARNED, Results, read_tables
from taxinet_ros.study.report.tables import distances_frame, networks_frame
from taxinet_ros.study.stages.config import read_config, shipped_config
from taxinet_ros.study.stages.plan import learned_program
from taxinet_ros.trials.rates import rate

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / 'docs' / 'case_study.md').read_text()
DOCS = (ROOT / 'benchmarks' / 'RESULTS.md').read_text()


@pytest.fixture(scope='module')
def found():
    return gather_findings(read_config(shipped_config()), ROOT / 'bags', ROOT / 'bags')


def words(claim: Claim) -> str:
    if claim.verdict is Verdict.UNCLEAR:
        return f'- {claim.statement}\n'
    return f'| {claim.statement} | {claim.evidence} | {p_words(claim.p_value)} |'


def part(verdict: Verdict) -> str:
    """What the page has below a verdict's heading."""
    heading = verdict.value[0].upper() + verdict.value[1:]
    return DOCS.partition(f'### {heading}\n')[2].partition('\n##')[0] + '\n'


def test_paper_given_the_shipped_tables_then_the_docs_have_each_verdict_with_its_figures(found):
    assert len(found.claims) == 36
    missing = [claim.name for claim in found.claims if words(claim) not in part(claim.verdict)]
    assert missing == []
    counts = Counter(claim.verdict for claim in found.claims)
    head = ', '.join(f'{counts[verdict]} {verdict.value}' for verdict in Verdict)
    assert f'Of {len(found.claims)} statements of the paper: {head}' in DOCS
    assert f'Of {len(found.claims)} statements of the paper: {head}' in PAGE


@pytest.mark.skipif(
    not same_stack(ROOT / 'bags' / 'golden'), reason='libraries other than those of the tables')
def test_determinism_given_a_run_of_each_table_when_made_again_then_every_bit_is_the_same():
    tables = [pd.read_parquet(path) for path in sorted((ROOT / 'bags').glob('s_falsif_*.parquet'))]
    tables += [pd.read_parquet(ROOT / 'bags' / 'learn-ce-2' / 'runs.parquet')]
    assert len(tables) == 12
    for (program, seed), group in itertools.groupby(
            sorted(tables, key=scenes_of), key=scenes_of):
        with SceneSource(program, seed=seed) as source:
            for table in group:
                row = table.loc[table.rho.idxmin()]  # the worst: where a last bit is amplified
                point = tuple(None if pd.isna(value := row.get(f'u_{dimension.name}')) else value
                              for dimension in source.space())
                scene = source.scene(int(row['index']), point, attempt=int(row.refused))
                again = tx.run(scene, perception=row.perception)
                assert again.rho['phi_eventually'].lower == row.rho, row.perception
                assert again.trace.cte_m.abs().max() == row.max_cross_track_m


def scenes_of(table: pd.DataFrame) -> tuple[str, int]:
    return str(table.program.iloc[0]), int(table.seed.iloc[0])


def test_paper_given_the_four_that_were_not_judged_then_the_tables_say_that_they_do_not_hold(found):
    verdicts = {claim.name: claim.verdict for claim in found.claims}
    names = ('clouds_reversal', 'late_morning', 'original_start', 'specialised_metres')
    assert {verdicts[name] for name in names} == {Verdict.DIFFERS}


def test_statements_that_were_missing_are_judged_and_five_equal_searches_decide_none(found):
    claims = {claim.name: claim for claim in found.claims}
    for verdict, names in {
        Verdict.DIFFERS: ('original_offset',),
        Verdict.AGREES: ('halton_off_original', 'specialised_off_original'),
        Verdict.UNCLEAR: ('original_angle', 'generic_day_clouds', 'halton_day_clouds', 'learned',
                          'learned_on_crossing', 'learned_at_start'),
    }.items():
        assert {claims[name].verdict for name in names} == {verdict}
    assert claims['original_angle'].evidence.startswith(
        'then and there of such starts 35.0 % (28.9-41.5) of 234 runs fail, of the others 31.7 %')


def test_the_third_arm_is_the_network_that_was_trained_on_what_the_papers_rule_learned(found):
    arm, config = found.results.networks['iterative-learned'], read_config(shipped_config())
    assert arm.runs.perception == LEARNED
    assert f' --add {learned_program(config)}={config.added} ' in arm.card['command_line']


def test_t14_study_given_the_shipped_searches_then_there_are_five_by_each_rule_and_the_spread(
    found,
):
    results: Results = found.results
    assert set(results.searches) == {'ce', 'ce-verifai'}
    for searches in results.searches.values():
        assert sorted(search.facts['seed'] for search in searches) == [2, 3, 4, 5, 6]
        assert {search.facts['perception'] for search in searches} == {'generic'}
    frame = found.learned
    for name in ('ce', 'ce-verifai'):
        assert frame[name].sum() == pytest.approx(1)
        assert (frame[f'{name}_least'] <= frame[name]).all()
        assert (frame[name] <= frame[f'{name}_greatest']).all()
    assert frame['weighted'].sum() == pytest.approx(1)
    assert (frame['weighted_low'] <= frame['weighted']).all()
    for _, line in frame.iterrows():
        for name, low, high in (('ce', '_least', '_greatest'), ('of_failures', '_low', '_high'),
                                ('ce-verifai', '_least', '_greatest'),
                                ('weighted', '_low', '_high')):
            ends = f'({100 * line[name + low]:.1f}-{100 * line[name + high]:.1f})'
            assert f'{100 * line[name]:.1f} % {ends}' in DOCS


@pytest.mark.nightly
def test_paper_given_tables_then_the_command_reports_them(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('taxinet_ros.analysis.report.page.write_report', lambda *_: None)
    lines = report_case_study(Path('new'), tables=ROOT / 'bags')
    assert any(line.startswith('late_morning: Not as in the paper (p ') for line in lines)
    assert (tmp_path / 'new' / 'report' / 'case_study.json').is_file()
    with pytest.raises(UsageError, match='out new: already exists'):
        report_case_study(Path('new'), tables=ROOT / 'bags')


def test_paper_given_a_folder_without_tables_then_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r'tables empty: has no s_falsif_NETWORK_RUNS\.parquet'):
        report_case_study(Path('new'), tables=Path('empty'))
    assert list(tmp_path.iterdir()) == []


def test_paper_given_a_table_that_a_sampler_chose_then_it_is_no_evaluation(tmp_path):
    source = ROOT / 'bags' / 'learn-ce-2' / 'runs.parquet'
    (tmp_path / 's_falsif_generic_9.parquet').write_bytes(source.read_bytes())
    with pytest.raises(UsageError, match=r'were chosen by a sampler, .* with sampler ra'):
        read_tables(read_config(shipped_config()), tmp_path)


def test_given_an_evaluation_that_was_extended_then_its_intervals_hold_at_any_number_of_runs(found):
    generic = found.results.networks['generic']
    assert generic.satisfied == rate(364, 400)
    extended = replace(generic, runs=replace(generic.runs, anytime=True))
    results = replace(found.results, networks={'generic': extended})
    assert extended.satisfied == rate(364, 400, anytime=True)
    assert extended.off_runway == rate(0, 400, anytime=True)
    (line,) = networks_frame(results).to_dict('records')
    assert line['satisfied_low'] == rate(364, 400, anytime=True).low
    there = distances_frame(results).iloc[13]
    assert there['satisfied_high'] == rate(
        there['satisfied_runs'], there['runs'], anytime=True).high
