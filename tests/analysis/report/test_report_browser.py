"""The page of a report in a browser."""

from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from report_browser import NARROW, browser, opened
from report_examples import HOSTILE, LINK, NEEDS_OUR_STACK, hostile_report, plain_report

from taxinet_ros.analysis.report.page import write_report_page
from taxinet_ros.analysis.report.values import clean

__all__ = ['browser']

RUN = '#run=truth-nominal'
CURSOR_X = "new DOMMatrix(getComputedStyle(document.querySelector('.cursor')).transform).e"
SHOWN_IMAGES = """[...document.querySelectorAll('.picture img')]
    .filter((image) => image.checkVisibility()).map((image) => image.className)"""
TITLE = "document.querySelector('#viewer-title').textContent"
PIXELS = "document.querySelector('#viewer-camera').toDataURL()"
SEEN = f"""[{CURSOR_X}, {PIXELS}, document.querySelector('.aircraft').getAttribute('transform'),
    document.querySelector('.key-truth output').textContent]"""
FOREIGN = """() => {
    const script = document.createElement('script');
    script.textContent = 'window.hacked = 5';
    document.body.append(script);
    return window.hacked;
}"""
LUMINANCES = """(names) => names.map((name) => {
    const probe = document.body.appendChild(document.createElement('i'));
    probe.style.color = `var(--${name})`;
    const channels = getComputedStyle(probe).color.match(/[0-9.]+/g).map((c) => c / 255);
    const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
    const [r, g, b] = channels.map(linear);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
})"""
SIDEWAYS = """[document.documentElement, document.querySelector('#viewer')].map(
    (element) => element.scrollWidth - element.clientWidth)"""


@pytest.fixture(scope='session')
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('page') / 'report.html'
    write_report_page(plain_report(), path)
    return path


@pytest.fixture(scope='session')
def attacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('page') / 'a page #1.html'
    write_report_page(hostile_report(), path)
    return path


def test_given_a_page_when_opened_then_it_is_quiet_and_shows_what_was_written(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        assert now.tab.title() == 's_falsif, 60 runs'
        assert now.tab.locator('.table-state').inner_text() == '1–25 of 60 rows'
        assert len(now.column(1)) == 25
        assert not now.tab.locator('#viewer').is_visible()


def test_given_a_table_when_taken_over_by_the_script_then_the_rows_stay_as_they_were(
    browser: Any, page: Path,
) -> None:
    body = "document.querySelector('tbody').innerHTML.replace(/\\s+(?=<)|\\s+$/g, '')"
    with opened(browser, page) as now:
        written = now.tab.evaluate(body)
        now.tab.locator('.page-after').click()
        assert now.column(1)[0] == 'run-25'
        now.tab.locator('.page-before').click()
        assert now.tab.evaluate(body).replace(' class=""', '') == written


def test_given_a_table_when_a_header_is_pressed_then_it_sorts_and_the_unknown_stay_last(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        header = now.tab.locator('th').nth(1)
        header.locator('button').focus()
        now.tab.keyboard.press('Enter')
        assert header.get_attribute('aria-sort') == 'ascending'
        assert now.column(2)[:2] == ['−∞', '−49.29']
        now.tab.keyboard.press('Enter')
        assert header.get_attribute('aria-sort') == 'descending'
        shown = [float(text.replace('−', '-')) for text in now.column(2)]
        assert shown == sorted(shown, reverse=True)
        for _ in range(2):
            now.tab.locator('.page-after').click()
        assert now.column(2)[-9:] == ['–'] * 9
        assert now.tab.locator('.page-after').is_disabled()
        now.tab.locator('th button').first.click()
        assert now.column(1)[:3] == ['run-2', 'run-3', 'run-4']


def test_given_a_table_when_words_are_typed_then_only_rows_with_all_of_them_stay(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        field = now.tab.locator('.table-filter')
        field.fill('RAIN yes')
        assert now.tab.locator('.table-state').inner_text() == '10 of 60 rows'
        assert set(now.column(4)) == {'rain'}
        field.fill('nothing of this kind')
        assert now.tab.locator('.table-state').inner_text() == '0 of 60 rows'
        field.fill('')
        assert now.tab.locator('.table-state').inner_text() == '1–25 of 60 rows'


def test_given_a_table_when_copied_then_the_clipboard_has_all_chosen_rows_as_csv(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        now.tab.context.grant_permissions(['clipboard-read', 'clipboard-write'])
        now.tab.locator('.table-copy').click()
        now.tab.get_by_text('60 rows copied').wait_for()
        lines = now.tab.evaluate('navigator.clipboard.readText()').splitlines()
    assert len(lines) == 61
    assert lines[:3] == ['run_id,rho,left,weather', 'truth-nominal,,yes,rain',
                         'taxinet-midday,-∞,no,dry']


def test_given_one_chosen_row_when_copied_then_it_is_one_row(browser: Any, page: Path) -> None:
    with opened(browser, page) as now:
        now.tab.context.grant_permissions(['clipboard-read', 'clipboard-write'])
        now.tab.locator('.table-filter').fill('run-59')
        now.tab.locator('.table-copy').click()
        now.tab.get_by_text('1 row copied').wait_for()


def test_given_a_filter_and_an_order_when_printed_then_every_chosen_row_is_on_paper(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        now.tab.locator('.table-filter').fill('dry')
        now.tab.locator('th button').nth(1).click()
        shown = now.column(1)
        now.tab.evaluate("dispatchEvent(new Event('beforeprint'))")
        printed = now.column(1)
        assert len(printed) == 40 == len(set(printed))
        assert printed[:25] == shown
        assert now.tab.locator('.table-state').inner_text() == '40 of 60 rows'
        now.tab.evaluate("dispatchEvent(new Event('afterprint'))")
        assert now.column(1) == shown


@pytest.mark.nightly
@pytest.mark.parametrize('width', [1400, 420])
def test_given_columns_beyond_the_side_when_asked_for_then_they_come_into_view(
    browser: Any, page: Path, width: int,
) -> None:
    with opened(browser, page, size={'width': width, 'height': 900}) as now:
        more = now.tab.locator('.table-more')
        now.tab.evaluate("""() => {
            for (const cell of document.querySelectorAll('th')) cell.style.minWidth = '30rem';
        }""")
        now.wait_until("!document.querySelector('.table-more').hidden")
        last = "document.querySelector('th:last-child').getBoundingClientRect().right"
        more.click()
        for _ in range(8):
            before = now.tab.locator('.table-scroll').evaluate('box => box.scrollLeft')
            # It may be gone by the time that a mouse is there, which would wait for it for ever.
            if more.evaluate('button => button.hidden || button.click()'):
                break
            now.wait_until(
                "(box => box.scrollLeft >= Math.min("
                f"{before} + 0.7 * box.clientWidth, box.scrollWidth - box.clientWidth - 1))"
                "(document.querySelector('.table-scroll'))")
        now.wait_until("document.querySelector('.table-more').hidden")
        assert now.tab.evaluate(last) <= width


def test_given_a_link_of_a_run_when_followed_then_its_viewer_opens_and_back_closes_it(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        now.tab.get_by_role('link', name='truth-nominal').first.click()
        dialog = now.tab.locator('#viewer')
        dialog.wait_for()
        assert now.tab.url.endswith(RUN)
        assert now.tab.locator('#viewer-title').inner_text() == 'truth-nominal'
        now.tab.locator('#viewer-after').click()
        now.wait_until("location.hash === '#run=taxinet-midday'")
        # The viewer shows the run when the event arrives that follows the change of the address.
        now.wait_until("document.querySelector('#viewer-place').textContent === '2 of 2'")
        now.tab.go_back()
        dialog.wait_for(state='hidden')
        assert '#' not in now.tab.url


def test_given_an_open_viewer_when_escape_is_pressed_then_the_address_forgets_the_run(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page, RUN) as now:
        now.tab.locator('#viewer').wait_for()
        now.tab.keyboard.press('Escape')
        now.tab.locator('#viewer').wait_for(state='hidden')
        now.wait_until("location.hash === ''")


def test_given_an_address_of_no_run_when_opened_or_followed_then_there_is_the_page(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page, '#run=%E0%A4%A') as now:
        assert not now.tab.locator('#viewer').is_visible()
        for fragment in ('#run=truth-nominal', '#run=gone', '#run='):
            now.tab.goto(page.as_uri() + fragment)
            state = 'visible' if fragment == RUN else 'hidden'
            now.tab.locator('#viewer').wait_for(state=state)


def test_given_an_open_viewer_when_keys_are_pressed_then_the_step_follows(
    browser: Any, page: Path,
) -> None:
    presses = [
        ('ArrowLeft', 0), ('ArrowRight', 1), ('ArrowRight', 2), ('ArrowLeft', 1),
        ('Shift+ArrowRight', 11), ('End', 120), ('ArrowRight', 120), ('Shift+ArrowLeft', 110),
        ('Home', 0), ('Shift+ArrowRight', 10),
    ]
    with opened(browser, page, RUN) as now:
        for focus in ('#viewer-play', '#viewer-scrubber', '#viewer-close'):
            now.tab.locator(focus).focus()
            for key, step in presses:
                now.tab.keyboard.press(key)
                words = now.tab.locator('#viewer-readout').inner_text()
                assert words.startswith(f'{step / 10:.1f} s · step {step} of 120 · '), (focus, key)
            now.tab.keyboard.press('Home')
        now.tab.keyboard.press('n')
        now.wait_until("location.hash === '#run=taxinet-midday'")
        now.wait_until(f"{TITLE} === 'taxinet-midday'")
        assert now.step() == 0


@NEEDS_OUR_STACK
def test_given_an_open_viewer_when_scrubbed_then_frame_path_cursor_and_numbers_move(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page, RUN) as now:
        now.tab.locator('#viewer').wait_for()
        now.wait_until(f'{PIXELS}.length > 20000')
        before = now.tab.evaluate(SEEN)
        now.tab.locator('#viewer-scrubber').fill('47')
        now.wait_until(f'{PIXELS} !== {before[1]!r}')
        after = now.tab.evaluate(SEEN)
        assert len(before) == 4
        assert all(one != other for one, other in zip(before, after, strict=True))
        words = now.tab.locator('#viewer-readout').inner_text()
        assert 'step 47 of 120 · frame 10 of 25' in words


def test_given_an_open_viewer_when_pointed_into_a_plot_then_that_moment_is_shown(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page, RUN) as now:
        box = now.tab.locator('.plot').nth(1).bounding_box()
        now.tab.mouse.click(box['x'] + 46 + (box['width'] - 47) / 2, box['y'] + 20)
        assert now.step() == 60


def test_given_an_open_viewer_when_played_then_it_goes_on_until_paused(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page, RUN) as now:
        now.tab.locator('#viewer').wait_for()
        now.tab.locator('#viewer-speed').select_option('5')
        now.tab.locator('#viewer-play').focus()
        now.tab.keyboard.press('Space')
        assert now.tab.locator('#viewer-play').get_attribute('aria-label') == 'Pause'
        now.wait_until("Number(document.querySelector('#viewer-scrubber').value) > 5")
        now.tab.locator('#viewer-scrubber').focus()
        now.tab.keyboard.press('Space')
        assert now.tab.locator('#viewer-play').get_attribute('aria-label') == 'Play'
        assert now.step() > 5
        now.tab.keyboard.press('End')
        now.tab.keyboard.press('Space')
        now.wait_until("Number(document.querySelector('#viewer-scrubber').value) < 60")


@pytest.mark.nightly
@pytest.mark.parametrize(('colours', 'other'), [('light', 'dark'), ('dark', 'light')])
def test_given_light_or_dark_when_changed_then_pictures_and_ground_change(
    browser: Any, page: Path, colours: str, other: str,
) -> None:
    ground = {'light': 'rgb(255, 255, 255)', 'dark': 'rgb(22, 25, 29)'}
    colour = 'getComputedStyle(document.body).backgroundColor'
    with opened(browser, page, colours=colours) as now:
        for wanted in (colours, other, colours):
            assert now.tab.evaluate(SHOWN_IMAGES) == [f'when-{wanted}']
            assert now.tab.evaluate(colour) == ground[wanted]
            now.tab.locator('#theme').click()
        now.tab.emulate_media(media='print', color_scheme='dark')
        assert now.tab.evaluate(SHOWN_IMAGES) == ['when-light']
        assert now.tab.evaluate(colour) == ground['light']


def test_given_a_narrow_window_when_opened_then_nothing_scrolls_sideways(
    browser: Any, page: Path, attacked: Path,
) -> None:
    for path, fragment in ((page, RUN), (attacked, f'#run={quote(LINK)}')):
        with opened(browser, path, size=NARROW) as now:
            assert now.tab.evaluate(SIDEWAYS) == [0, 0]
            now.tab.goto(path.as_uri() + fragment)
            now.tab.locator('#viewer').wait_for()
            assert now.tab.evaluate(SIDEWAYS) == [0, 0]


def test_given_hostile_words_when_everything_is_used_then_nothing_of_theirs_runs(
    browser: Any, attacked: Path,
) -> None:
    with opened(browser, attacked, f'#run={quote(LINK)}') as now:
        dialog = now.tab.locator('#viewer')
        dialog.wait_for()
        assert now.tab.locator('#viewer-title').text_content() == LINK
        now.tab.keyboard.press('p')
        now.wait_until(f"!{TITLE}.startsWith('javascript')")
        assert now.tab.locator('#viewer-title').text_content() == clean(HOSTILE)
        now.tab.keyboard.press('Escape')
        dialog.wait_for(state='hidden')
        for header in now.tab.locator('th button').all():
            header.click()
        now.tab.locator('.table tbody a').first.click()
        dialog.wait_for()
        assert now.tab.evaluate('window.hacked') is None


def test_given_a_foreign_script_when_it_slips_in_then_the_policy_stops_it(
    browser: Any, page: Path,
) -> None:
    with opened(browser, page) as now:
        assert now.tab.evaluate(FOREIGN) is None
        assert len(now.complaints) == 1
        assert 'Content Security Policy' in now.complaints.pop()


def test_given_the_sides_of_a_page_when_measured_then_words_stand_out_from_the_ground(
    browser: Any, page: Path,
) -> None:
    for colours in ('light', 'dark'):
        with opened(browser, page, colours=colours) as now:
            paper, soft, control, *words = now.tab.evaluate(
                LUMINANCES, ['paper', 'soft', 'control', 'ink', 'muted', 'link', 'good', 'bad'])
        grounds = (paper, soft)
        ratios = [
            (max(word, ground) + 0.05) / (min(word, ground) + 0.05)
            for word in words for ground in grounds
        ]
        assert min(ratios) >= 4.5
        assert (max(control, paper) + 0.05) / (min(control, paper) + 0.05) >= 3
