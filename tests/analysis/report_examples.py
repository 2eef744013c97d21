"""Reports to make pages of: one that is plain, and one whose every word is an attack."""

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import (
    Column,
    Link,
    Picture,
    Report,
    Section,
    Table,
    Theme,
)
from taxinet_ros.bag.check.compare import same_stack

GOLDEN = Path(__file__).parents[2] / 'bags' / 'golden'
NEEDS_OUR_STACK = pytest.mark.skipif(
    not same_stack(GOLDEN), reason='the golden bags come from another stack'
)
RUNS = ('truth-nominal', 'taxinet-midday')

HOSTILE = (
    '</script><script>window.hacked = 1</script><img src=x onerror="window.hacked = 2">'
    '\'" onmouseover="window.hacked = 3" &lt;\u2028\u2029]]>--><!--\x00\ud800{{ 7 * 7 }}'
)
LINK = 'javascript:window.hacked=4'


def draw(figure: Figure, theme: Theme) -> None:
    """A curve in the theme's colours."""
    axes = figure.subplots()
    axes.plot([0, 1, 2], [2, 0, 1], color=theme.passed)
    axes.set_xlabel('time [s]')


def picture(name: str = 'curve', words: str = 'A curve') -> Picture:
    """A small picture."""
    return Picture(name=name, title=words, caption=words, draw=draw, size_in=(3.0, 1.5))


def run_table(count: int = 60, name: str = 'runs') -> Table:
    """Runs, the first with viewers; every seventh has no ρ, and number 1 an infinite one."""
    ids = [*RUNS, *(f'run-{number}' for number in range(len(RUNS), count))]
    rows = tuple(
        (run_id, _rho(number), number % 2 == 0, 'rain' if number % 3 == 0 else 'dry')
        for number, run_id in enumerate(ids)
    )
    columns = (
        Column(name='run_id', title='run'), Column(name='rho', title='ρ [m]', decimals=2),
        Column(name='left', title='left'), Column(name='weather', title='weather'),
    )
    return Table(name=name, title='All runs', caption='A row for each.', columns=columns, rows=rows,
                 run_id_column='run_id')


def _rho(number: int) -> float | None:
    if number % 7 == 0:
        return None
    return float('-inf') if number == 1 else 10.0 - number * 1.005


def plain_report() -> Report:
    """Two runs with viewers, one without a bag, a picture, and a table of three pages."""
    section = Section(
        name='rates', heading='How often it fails', sentences=('Half of the time.',),
        commands=('taxinet train x --out y',),
        links=(Link(words='the analysis', path='analyze/a report.html'),),
        pictures=(picture(),), tables=(run_table(),),
    )
    return Report(
        title='s_falsif, 60 runs', facts={'perception': 'original', 'seed': '0'},
        summary=('Rain is the cause.', 'The crossing is another.'), sections=(section,),
        runs={**{name: GOLDEN / name for name in RUNS}, 'gone': GOLDEN / 'gone'},
        worst=RUNS[1], rho={RUNS[1]: -1.304}, made_on='one machine',
    )


def hostile_report() -> Report:
    """Every word that a campaign could bring along is an attack."""
    columns = (Column(name=HOSTILE, title=HOSTILE), Column(name='link', title=LINK))
    table = Table(name='table', title=HOSTILE, caption=HOSTILE, columns=columns,
                  rows=((HOSTILE, LINK), (LINK, HOSTILE)), run_id_column=HOSTILE)
    links = (Link(words=HOSTILE, path=LINK), Link(words=LINK, path=f'//host/{HOSTILE}'))
    section = Section(name='section', heading=HOSTILE, sentences=(HOSTILE, LINK),
                      commands=(HOSTILE,), links=links,
                      pictures=(picture(words=HOSTILE),), tables=(table,))
    return Report(
        title=HOSTILE, facts={HOSTILE: HOSTILE, 'link': LINK}, summary=(HOSTILE,),
        sections=(section,),
        runs={HOSTILE: GOLDEN / RUNS[0], LINK: GOLDEN / RUNS[0], 'gone': Path(f'/{LINK}<b>')},
    )
