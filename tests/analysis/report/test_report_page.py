"""The page of a report: its structure, and that nothing in it runs that is not ours."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from campaign_records import write_campaign
from report_examples import HOSTILE, LINK, RUNS, hostile_report, plain_report, run_table

from taxinet_ros.analysis.report.page import write_report_page
from taxinet_ros.analysis.report.parts import Report, Section

ELEMENTS_WITHOUT_END = {'meta', 'link', 'img', 'input', 'br', 'hr'}
KILOBYTE = 1024


class Reader(HTMLParser):
    """What a page consists of; fails where elements are not closed in order."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ELEMENTS_WITHOUT_END:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._open:
            self.words.setdefault(self._open[-1], []).append(data)

    def all(self, tag: str) -> list[dict[str, str | None]]:
        """Attributes of every element of a kind."""
        return [attributes for name, attributes in self.elements if name == tag]


def written(report: Report, folder: Path) -> str:
    """The page of a report."""
    path = folder / 'report.html'
    write_report_page(report, path)
    assert list(folder.iterdir()) == [path]
    return path.read_text(encoding='utf-8')


@pytest.fixture(scope='module')
def plain(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(plain_report(), tmp_path_factory.mktemp('plain'))


@pytest.fixture(scope='module')
def hostile(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(hostile_report(), tmp_path_factory.mktemp('hostile'))


def test_given_a_report_when_written_then_everything_of_it_is_on_the_page(plain: str) -> None:
    page = Reader(plain)
    assert page.words['h1'] == ['s_falsif, 60 runs']
    assert page.words['dt'][:2] == ['perception', 'seed']
    assert {'Summary', 'How often it fails'} <= set(page.words['h2'])
    assert {'Rain is the cause.', 'Half of the time.'} <= set(page.words['p'])
    assert [one['scope'] for one in page.all('th')] == ['col'] * 4
    assert len(page.all('tr')) == 1 + 25


def test_given_a_worst_run_when_written_then_its_frame_and_path_stand_before_the_evidence(
    plain: str,
) -> None:
    first, rest = plain.split('id="section-rates"')
    assert 'The worst run: <a href="#run=taxinet-midday">taxinet-midday</a>, ρ −1.30' in first
    assert 'class="worst-frame" src="data:image/webp;base64,' in first
    assert first.count('alt="The path of this run"') == 2, 'for light and dark'
    assert 'm right' in first or 'm left' in first
    assert '<span class="rho">ρ −1.30</span>' in rest
    assert 'The runs were made on one machine.' in rest
    assert 'time of day 12:00' in plain, 'clock times, as in tables and figures'


def test_given_pages_in_a_campaigns_folder_when_written_then_it_has_a_list_of_them(
    tmp_path: Path,
) -> None:
    write_campaign(tmp_path)
    for name in ('analysis', 'why'):
        (tmp_path / name).mkdir()
        report = Report(title=f'Of {name}', facts={}, summary=(), sections=())
        write_report_page(report, tmp_path / name / 'page.html')
    text = (tmp_path / 'index.html').read_text(encoding='utf-8')
    for name in ('analysis', 'why'):
        assert f'<a href="{name}/page.html">Of {name}</a>' in text
        assert 'index.html' not in (tmp_path / name / 'page.html').read_text(encoding='utf-8')


def test_given_a_report_when_written_then_the_contents_lead_to_every_section(plain: str) -> None:
    page = Reader(plain)
    places = {attributes.get('id') for _, attributes in page.elements}
    links = [one['href'] for one in page.all('a') if not str(one['href']).startswith('#run=')]
    *inner, other = links
    assert inner == ['#content', '#summary', '#section-rates', '#runs']
    assert {link[1:] for link in inner} <= places
    assert other == './analyze/a%20report.html'
    assert 'taxinet train x --out y' in page.words['code']


def test_given_a_report_when_written_then_no_name_stands_twice(plain: str) -> None:
    names = [attributes['id'] for _, attributes in Reader(plain).elements if 'id' in attributes]
    assert len(names) > 10
    assert len(names) == len(set(names))


def test_given_a_picture_when_written_then_it_is_there_for_light_and_dark(plain: str) -> None:
    images = [one for one in Reader(plain).all('img') if one['alt'] == 'A curve']
    assert [one['class'] for one in images] == ['when-light', 'when-dark']
    shape = {(one['alt'], one['width'], one['height']) for one in images}
    assert shape == {('A curve', '288', '144')}
    files = [base64.b64decode(str(one['src']).partition(',')[2]) for one in images]
    assert [file[8:12] for file in files] == [b'WEBP', b'WEBP']
    assert files[0] != files[1]


def test_given_runs_when_written_then_each_has_its_data_and_links_to_it(plain: str) -> None:
    blocks = [one.get('id') for one in Reader(plain).all('script')]
    assert [f'run-data-{number}' in blocks for number in range(3)] == [True, True, False]
    ids = re.search(r'id="run-ids">(.*?)<', plain)
    assert ids is not None
    assert json.loads(ids.group(1)) == list(RUNS)
    assert plain.count('href="#run=truth-nominal"') == 2


def test_given_a_run_without_a_bag_when_written_then_the_page_says_why_on_one_line(
    plain: str,
) -> None:
    assert re.search(r'<b>gone</b> has no viewer: .*golden/gone: no such bag;', plain)


def test_given_a_report_without_runs_when_written_then_there_is_no_viewer(tmp_path: Path) -> None:
    page = Reader(written(replace(plain_report(), runs={}), tmp_path))
    assert not page.all('dialog')
    assert not any(str(one['href']).startswith('#run') for one in page.all('a'))


@pytest.mark.nightly
def test_given_the_same_report_when_written_again_then_the_bytes_are_equal(
    plain: str, tmp_path: Path,
) -> None:
    told: list[str] = []
    write_report_page(plain_report(), tmp_path / 'report.html', on_progress=told.append)
    assert (tmp_path / 'report.html').read_text(encoding='utf-8') == plain
    assert told == [
        'run 1 of 3: truth-nominal', 'run 2 of 3: taxinet-midday', 'run 3 of 3: gone',
        'picture curve', 'writing report.html',
    ]


def test_given_4000_runs_in_a_table_when_written_then_the_page_stays_small(
    plain: str, tmp_path: Path,
) -> None:
    section = Section(name='all', heading='All', tables=(run_table(4000),))
    report = Report(title='many', facts={}, summary=(), sections=(section,))
    assert len(written(report, tmp_path)) < 250 * KILOBYTE
    # Two runs of 12 s; 20 of 30 s would be 25 times as much, and must stay below 13 MB.
    assert len(plain) < 500 * KILOBYTE


def test_given_a_page_when_written_then_only_our_own_style_and_script_may_run(
    plain: str, hostile: str,
) -> None:
    for html in (plain, hostile):
        policy = str(next(m['content'] for m in Reader(html).all('meta') if 'http-equiv' in m))
        scripts = re.findall(r'<script>(.*?)</script>', html, re.DOTALL)
        styles = re.findall(r'<style>(.*?)</style>', html, re.DOTALL)
        assert (len(scripts), len(styles)) == (1, 1)
        assert f"script-src '{_digest(scripts[0])}';" in policy
        assert f"style-src '{_digest(styles[0])}';" in policy
        assert policy.startswith("default-src 'none'; img-src data:;")


def test_given_hostile_words_when_written_then_they_are_words(plain: str, hostile: str) -> None:
    page, calm = Reader(hostile), Reader(plain)
    assert {tag for tag, _ in page.elements} <= {tag for tag, _ in calm.elements}
    assert {one.get('type') for one in page.all('script')} == {'application/json', None}
    assert not any(name.startswith('on') for name in _attribute_names(page))
    assert _attribute_names(page) <= _attribute_names(calm)
    seen = HOSTILE.replace('\0', '\ufffd').replace('\ud800', '\ufffd')
    assert ''.join(page.words['h1']) == seen
    assert '\0' not in hostile
    assert '{{ 7 * 7 }}' in hostile


def test_given_hostile_links_when_written_then_every_address_stays_within_the_folder(
    hostile: str,
) -> None:
    page = Reader(hostile)
    addresses = [str(one['href']) for one in page.all('a')]
    assert len(addresses) > 4
    others = [address for address in addresses if not address.startswith('#')]
    assert len(others) == 2
    # Relative paths of plain characters: no scheme, and no other host.
    assert all(re.fullmatch(r'\./[\w%./~-]+', address) for address in others)
    assert others[0] == f'./{LINK.replace(":", "%3A").replace("=", "%3D")}'
    assert {str(one['src']).partition(',')[0] for one in page.all('img')} == {
        'data:image/webp;base64'}
    assert f'#run={LINK.replace(":", "%3A").replace("=", "%3D")}' in addresses


def test_given_a_page_when_written_then_it_names_no_other_address(plain: str) -> None:
    rest = plain.replace('http://www.w3.org/2000/svg', '')
    assert not re.search(r'https?://|url\(|@import|<link(?! rel="icon" href="data:,")', rest)


def test_given_a_folder_that_is_missing_when_written_then_it_is_said(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r'report\.html'):
        write_report_page(replace(plain_report(), runs={}), tmp_path / 'gone' / 'report.html')


def test_given_a_table_that_contradicts_itself_when_written_then_the_old_page_stays(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'report.html'
    path.write_text('before')
    table = replace(run_table(2), run_id_column='other')
    sections = (Section(name='a', heading='A', tables=(table,)),)
    with pytest.raises(ValueError, match='other'):
        write_report_page(Report(title='a', facts={}, summary=(), sections=sections), path)
    assert path.read_text() == 'before'


def _attribute_names(page: Reader) -> set[str]:
    return {name for _, attributes in page.elements for name in attributes}


def _digest(text: str) -> str:
    return 'sha256-' + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')
