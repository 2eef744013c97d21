"""Links between the pages of one campaign."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from taxinet_ros.files.pages import PAGES_NAME, PLACE, add_page, page_sha256
from taxinet_ros.files.sealed_json import file_sha256


def page(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<header>{PLACE}</header><p>{path.stem}</p>', encoding='utf-8')
    return path


def links(path: Path) -> dict[str, str]:
    found = re.findall('<a href="([^"]*)">([^<]*)</a>', path.read_text(encoding='utf-8'))
    return {words: address for address, words in found}


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    folder = tmp_path / 'found'
    folder.mkdir()
    return folder


def test_given_pages_in_any_folder_when_added_then_each_links_to_all_others(
    campaign: Path, tmp_path: Path,
) -> None:
    analysis = page(campaign / 'analysis' / 'report.html')
    why = page(tmp_path / 'found why' / 'why.html')
    add_page(campaign, analysis, 'Analysis')
    assert links(analysis) == {}, 'there is no other'
    add_page(campaign, why, 'Why <it> failed')
    assert links(analysis) == {'Why &lt;it&gt; failed': './../../found%20why/why.html'}
    assert links(why) == {'Analysis': './../found/analysis/report.html'}
    assert '<b aria-current="page">Analysis</b>' in analysis.read_text()
    assert analysis.read_text().endswith('<p>report</p>'), 'the rest of the page is as it was'


def test_given_a_page_that_is_gone_when_another_comes_then_nothing_links_to_it(
    campaign: Path,
) -> None:
    first, second, third = (page(campaign / name / 'a.html') for name in ('a', 'b', 'c'))
    for one in (first, second):
        add_page(campaign, one, one.parent.name)
    first.unlink()
    add_page(campaign, third, 'c')
    assert links(second) == {'c': './../c/a.html'}
    assert 'a/a.html' not in (campaign / PAGES_NAME).read_text()


def test_given_a_page_that_is_made_anew_when_added_again_then_it_is_listed_once(
    campaign: Path,
) -> None:
    first, second = (page(campaign / name) for name in ('a.html', 'b.html'))
    for one in (first, second, page(first)):
        add_page(campaign, one, one.stem)
    assert links(first) == {'b': './b.html'}
    assert links(second) == {'a': './a.html'}


@pytest.mark.parametrize('text', ['{', '[]', '{"pages": [1]}', '{"pages": [{"path": 1}]}', ''])
def test_given_a_damaged_list_when_a_page_is_added_then_it_begins_anew(
    campaign: Path, text: str,
) -> None:
    (campaign / PAGES_NAME).write_text(text)
    first, second = (page(campaign / name) for name in ('a.html', 'b.html'))
    add_page(campaign, first, 'a')
    add_page(campaign, second, 'b')
    assert links(first) == {'b': './b.html'}


def test_given_a_file_without_a_place_for_links_then_it_stays_as_it_is(campaign: Path) -> None:
    foreign, ours = campaign / 'foreign.html', page(campaign / 'a.html')
    foreign.write_text('<p>mine</p>')
    add_page(campaign, foreign, 'foreign')
    add_page(campaign, ours, 'a')
    assert foreign.read_text() == '<p>mine</p>'
    assert links(ours) == {'foreign': './foreign.html'}


def test_given_links_that_come_and_go_then_the_checksum_of_the_page_is_the_same(
    campaign: Path,
) -> None:
    first, second = (page(campaign / name) for name in ('a.html', 'b.html'))
    before, bytes_before = page_sha256(first), file_sha256(first)
    add_page(campaign, first, 'a')
    add_page(campaign, second, 'b')
    assert file_sha256(first) != bytes_before
    assert page_sha256(first) == before
    first.write_text(first.read_text().replace('<p>a', '<p>changed'))
    assert page_sha256(first) != before
    assert page_sha256(campaign / PAGES_NAME) == file_sha256(campaign / PAGES_NAME)


def test_given_no_campaign_when_a_page_is_added_then_it_is_as_it_was(tmp_path: Path) -> None:
    alone = page(tmp_path / 'a.html')
    add_page(tmp_path / 'gone', alone, 'a')
    assert [path.name for path in tmp_path.iterdir()] == ['a.html']


def test_given_a_page_on_two_campaigns_then_it_has_the_links_of_each_and_each_links_to_it(
    campaign: Path, tmp_path: Path,
) -> None:
    other = tmp_path / 'before & after'
    other.mkdir()
    ours, theirs = page(campaign / 'a.html'), page(other / 'b.html')
    both = page(tmp_path / 'compared' / 'compare.html')
    for folder, one in ((campaign, ours), (campaign, both), (other, theirs), (other, both)):
        add_page(folder, one, one.stem)
    assert links(both) == {'a': './../found/a.html', 'b': './../before%20%26%20after/b.html'}
    assert (links(ours), links(theirs)) == (
        {'compare': './../compared/compare.html'}, {'compare': './../compared/compare.html'})
    text = both.read_text()
    assert text.count('<nav ') == 2
    assert '<span>Campaign found:</span>' in text
    assert '<span>Campaign before &amp; after:</span>' in text
    assert '<span>This campaign:</span>' in ours.read_text()
    before = page_sha256(both)
    shutil.rmtree(other)
    add_page(campaign, page(campaign / 'c.html'), 'c')
    assert links(both) == {'a': './../found/a.html', 'c': './../found/c.html'}, 'the other is gone'
    assert page_sha256(both) == before
