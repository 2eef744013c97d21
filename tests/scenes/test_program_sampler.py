"""The sampler that a program names in Scenic's way is used, or refused with its line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import falsify_samples as toy
import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.scenes.program_sampler import ProgramSampler, program_sampler
from taxinet_ros.scenes.source import SceneSource
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.search import DEFAULT_SAMPLER

PLACES = {'verifaiSamplerType': 'mine.scenic:3', 'verifaiSamplerParams': 'mine.scenic:4'}
CE = 'param verifaiSamplerType = "ce"\n'
PLANE = 'model runway_world\nfrom dotmap import DotMap\n'
EGO = 'ego = new Plane at (VerifaiRange(-1, 1), VerifaiRange(0, 9))\n'


def named(kind: str | None, **params: Any) -> ProgramSampler | None:
    return program_sampler(kind, params, PLACES if params else {
        'verifaiSamplerType': PLACES['verifaiSamplerType']
    })


@pytest.mark.parametrize(('kind', 'params', 'word', 'options'), [
    ('random', {}, 'random', {}),
    ('halton', {'sample_index': 0, 'bases_skipped': 0}, 'halton', {}),
    ('ce', {}, 'ce', {'rule': 'verifai', 'alpha': '0.9'}),
    ('ce', {'alpha': 0.95, 'thres': 0.0, 'cont': {'buckets': 5, 'dist': None},
            'disc': {'dist': None}}, 'ce', {'rule': 'verifai', 'alpha': '0.95'}),
    ('mab', {'cont': {'buckets': 5}}, 'mab', {}),
    ('grid', {'N': 21}, 'grid', {'points': '21'}),
    ('bo', {'init_num': 5}, 'bo', {'startup': '5'}),
    ('sobol', {}, 'sobol', {}),
])
def test_s4_a_sampler_of_verifai_is_one_of_ours(
    kind: str, params: dict[str, Any], word: str, options: dict[str, str]
) -> None:
    found = named(kind, **params)
    assert found is not None
    assert (found.word, found.options) == (word, options)
    assert (found.said, found.place) == (f'verifaiSamplerType = {kind!r}', 'mine.scenic:3')


def test_s4_every_sampler_here_can_be_named() -> None:
    words = {kind: named(kind) for kind in SAMPLERS}
    assert len(words) > 8
    assert all(found and found.word == kind for kind, found in words.items())


@pytest.mark.parametrize(('kind', 'params', 'message'), [
    ('eg', {}, "mine.scenic:3: verifaiSamplerType = 'eg' is unknown; known: random"),
    ('haltom', {}, "mine.scenic:3: verifaiSamplerType = 'haltom' is unknown; known: random"),
    ('ce', {'alpha': 2}, 'mine.scenic:3: sampler ce: alpha=2: needs to be within'),
    ('ce', {'thres': 0.5}, 'mine.scenic:4: verifaiSamplerParams.thres = 0.5: only 0 can be had'),
    ('ce', {'cont': {'dist': '[1 2]'}}, 'mine.scenic:4: verifaiSamplerParams.cont.dist = '),
    ('ce', {'disc': {'dist': '[1 2]'}}, 'mine.scenic:4: verifaiSamplerParams.disc.dist = '),
    ('ce', {'alhpa': 1}, 'mine.scenic:4: verifaiSamplerParams.alhpa = 1: has no effect on ce; '
                         'known: alpha, thres, cont.dist, disc.dist, cont.buckets'),
    ('mab', {'alpha': 0.9}, 'mine.scenic:4: verifaiSamplerParams.alpha = 0.9: has no effect on'),
    ('halton', {'sample_index': 7}, 'mine.scenic:4: verifaiSamplerParams.sample_index = 7: only 0'),
    ('halton', {'cont': {'buckets': 5}}, 'mine.scenic:4: verifaiSamplerParams.cont.buckets = 5'),
    ('random', {'x': 1}, 'mine.scenic:4: verifaiSamplerParams.x = 1: has no effect on random'),
    ('tpe', {'alpha': 1}, 'mine.scenic:3: sampler tpe: unknown option alpha; known: startup'),
    (None, {'alpha': 1}, 'mine.scenic:4: verifaiSamplerParams: of which sampler?'),
])
def test_s4_what_cannot_be_had_is_refused_with_its_line(
    kind: str | None, params: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError) as caught:
        named(kind, **params)
    assert str(caught.value).startswith(message)
    assert '\n' not in str(caught.value)


# A search takes it -------------------------------------------------------------------------------


def chosen(
    out: Path, monkeypatch: pytest.MonkeyPatch, asked: ProgramSampler | None, **options: Any
) -> Engine[search_module.Search]:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)
    monkeypatch.setattr(toy.ToySource, 'sampler', asked)
    return toy.finish(toy.options(out, runs=3, **options))


@pytest.mark.parametrize(('asked', 'options', 'word', 'kept', 'notes'), [
    (named('ce', alpha=0.95), {'sampler': ''}, 'ce', {'rule': 'verifai', 'alpha': '0.95'},
     ("sampler ce rule=verifai alpha=0.95, by verifaiSamplerType = 'ce' of mine.scenic:3",)),
    # An option of the command changes one of the program.
    (named('ce'), {'sampler': '', 'sampler_options': {'alpha': '0.99'}}, 'ce',
     {'rule': 'verifai', 'alpha': '0.99'},
     ("sampler ce rule=verifai alpha=0.99, by verifaiSamplerType = 'ce' of mine.scenic:3",)),
    (named('ce'), {'sampler': 'halton'}, 'halton', {},
     ("sampler halton, as asked; not the verifaiSamplerType = 'ce' of mine.scenic:3",)),
    (None, {'sampler': ''}, DEFAULT_SAMPLER, {}, ()),
])
def test_s4_a_search_uses_the_sampler_of_the_command_else_of_the_program_else_the_default(
    asked: ProgramSampler | None, options: dict[str, Any], word: str, kept: dict[str, str],
    notes: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    search = chosen(tmp_path, monkeypatch, asked, **options)
    assert search.book.facts['sampler'] == word
    assert search.book.facts['sampler_options'] == kept
    assert {row.sampler for row in search.rows} == {word}
    assert search.proposer.notes == notes


def test_s4_an_option_that_the_programs_sampler_lacks_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match='sampler halton: unknown option every'):
        chosen(tmp_path / 'c', monkeypatch, named('halton'), sampler='',
               sampler_options={'every': '1'})
    assert not (tmp_path / 'c').exists()


# The Scenic process reads it ---------------------------------------------------------------------


def test_s4_the_parameters_of_a_program_are_read_with_their_lines(
    compiled: Any, tmp_path: Path
) -> None:
    text = (
        'param verifaiSamplerType = "ce",\\\n    verifaiSamplerParams = DotMap(alpha=0.95,\\\n'
        '        cont=DotMap(buckets=4, dist=None))\n'
    )
    path = str(tmp_path / 'mine.scenic')
    assert compiled(PLANE + text + EGO)['sampler'] == {
        'kind': 'ce', 'params': {'alpha': 0.95, 'cont': {'buckets': 4, 'dist': None}},
        'feedback': None,
        'places': {'verifaiSamplerType': [path, 3], 'verifaiSamplerParams': [path, 3]},
    }


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'ego', 'buckets'), [
    ('', EGO, [10, 10]),
    ('param verifaiSamplerType = "halton"\n', EGO, [10, 10]),
    (CE, EGO, [5, 5]),
    ('param verifaiSamplerType = "mab"\n', EGO.replace('9)', '9, buckets=3)'), [5, 3]),
    (CE + 'param verifaiSamplerParams = DotMap(cont=DotMap(buckets=7))\n', EGO, [7, 7]),
    (CE + 'param verifaiSamplerParams = {"cont": {"buckets": 7}}\n',
     EGO.replace('Verifai', ''), [7, 7]),
])
def test_s4_ranges_are_cut_as_the_program_says(
    client: Any, compiled: Any, text: str, ego: str, buckets: list[int]
) -> None:
    assert compiled(PLANE + text + ego)['named'] == []
    choices = client.ask(op='space')['choices']
    assert [choice['dimension']['buckets'] for choice in choices] == buckets


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'line', 'message'), [
    ('param verifaiSamplerParams = 3\n', 3, 'verifaiSamplerParams is a int; it has to be a DotMap'),
    (CE + 'param verifaiSamplerParams = {"cont": {"buckets": [3, 4]}}\n', 4,
     'verifaiSamplerParams.cont.buckets is [3, 4]; it has to be a whole number above 0'),
    (CE + 'param verifaiSamplerParams = {"cont": {"buckets": 3}}\n'
     'param rain = VerifaiRange(0, 1, buckets=2)\n', 4,
     'verifaiSamplerParams.cont.buckets: a VerifaiRange has buckets of its own'),
])
def test_s4_parameters_that_cannot_be_read_are_refused_with_their_line(
    refused: Any, text: str, line: int, message: str
) -> None:
    refused(PLANE + text + EGO, line, message)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'message'), [
    ('param verifaiSamplerType = 3\n', ":3: verifaiSamplerType = '3' is unknown; known: random"),
    ('param verifaiSamplerType = Uniform("ce", "mab")\n', ':3: verifaiSamplerType = .* is unknown'),
    (CE + 'param verifaiSamplerParams = {"alpha": Range(0, 1)}\n',
     r':3: sampler ce: alpha=Range\(0.0, 1.0\)'),
])
def test_s4_a_sampler_by_chance_is_refused_with_its_line(
    write: Any, text: str, message: str
) -> None:
    with pytest.raises(UsageError, match=message), SceneSource(write(PLANE + text + EGO), seed=0):
        pass


def test_s4_the_external_sampler_that_scenic_has_itself_may_be_named(compiled: Any) -> None:
    text = (
        'from scenic.core.external_params import VerifaiSampler\n'
        'param externalSampler = VerifaiSampler\n'
    )
    assert compiled(PLANE + text + EGO)['named'] == []


def test_s4_scenes_without_a_sampler_say_so(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.chdir(tmp_path)
    Path('mine.scenic').write_text(PLANE + CE + 'param rain = 0.5\n' + EGO)
    with SceneSource('mine.scenic', seed=1) as source:
        assert source.sampler == ProgramSampler(
            word='ce', options={'rule': 'verifai', 'alpha': '0.9'},
            said="verifaiSamplerType = 'ce'", place='mine.scenic:3',
        )
        assert len(source.notes) == 1
        assert source.notes[0].startswith('mine.scenic:4: param rain is 0.5, and rain is in')
        assert source.drawn_notes == (
            *source.notes, 'scenes are drawn as the program has them, without a sampler: '
            "verifaiSamplerType = 'ce' of mine.scenic:3 is for taxinet falsify",
        )
