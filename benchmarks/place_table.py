"""Print the results of a campaign by place, worst first, and by light, runway width and category.

``python place_table.py CAMPAIGN [FILMS]``: a folder of ``taxinet run`` or ``falsify`` whose program
draws its place, such as ``places_test.scenic`` here. With a folder FILMS, the run with the lowest
robustness of each place that fails there, by day, becomes a film in it.
"""

from __future__ import annotations

import math
import random
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import taxinet_ros as tx
from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.trials.rates import rate

DRAWS = 2000
TWILIGHT_DEG = -1.0
"""Elevation of the sun below which a scene counts as dark: where the training ends."""


def percent(low_to_high: Iterable[float]) -> str:
    """Display text of a share and its interval."""
    return '{:.2f} % ({:.2f}-{:.2f})'.format(*(100 * part for part in low_to_high))


def over_places(shares: Sequence[float]) -> tuple[float, float, float]:
    """Mean share of the places, and the 95 % interval of resampled places."""
    draw = random.Random(0)
    means = [statistics.fmean(draw.choices(shares, k=len(shares))) for _ in range(DRAWS)]
    found = statistics.quantiles(means, n=40, method='inclusive')
    return statistics.fmean(shares), found[0], found[-1]


def light(scene: tx.Scenario) -> str:
    """Display text of the sun's height."""
    elevation_deg = math.degrees(
        sun_position(scene.date, scene.time_of_day_s, scene.runway)[1])
    return 'dark' if elevation_deg < TWILIGHT_DEG else 'day'


def print_row(title: str, rows: Any) -> None:
    """Print a row of the table."""
    satisfied, off = (rows.outcome == 'PASS').sum(), rows.left_runway.sum()
    cells = [title, len(rows), percent(rate(satisfied, len(rows))), percent(rate(off, len(rows)))]
    print('|', ' | '.join(map(str, cells)), '|')


def film(run: Path, out: Path) -> None:
    """Make a film of a run that was recorded without frames."""
    with tempfile.TemporaryDirectory() as folder:
        seen = Path(folder, 'seen')
        for words in (['render', run, '--out', seen], ['export', seen, '--out', out]):
            subprocess.run(['taxinet', 'bag', *map(str, words)], check=True, capture_output=True)


def print_tables(folder: Path, films: Path | None) -> None:
    """Print the tables of a campaign."""
    campaign = tx.open_campaign(folder)
    rows = campaign.rows[campaign.rows.outcome.isin(['PASS', 'FAIL'])].copy()
    scenes = {row.index: campaign.recorded.scenario(row)[0] for row in campaign.recorded.rows}
    runways = {row.place: scenes[row.index].runway for row in campaign.recorded.rows}
    rows['light'] = [light(scenes[index]) for index in rows['index']]
    rows['runway'] = [
        f'{place.split("@")[0]}, {runways[place].width_m:.0f} m, {runways[place].category}'
        for place in rows.place
    ]
    rows['width'] = [f'{runways[place].width_m:.0f} m wide' for place in rows.place]
    rows['category'] = [runways[place].category for place in rows.place]
    passed = rows.assign(passed=rows.outcome == 'PASS').groupby('runway').passed.mean()
    print('| runs | n | satisfied | leave the runway |')
    print('| --- | --- | --- | --- |')
    print_row('all', rows)
    for key in ('light', 'width', 'category'):
        for name, some in rows.groupby(key):
            print_row(name, some)
    for name in passed.sort_values(kind='stable').index:
        print_row(name, rows[rows.runway == name])
    print(f'mean of {len(passed)} places: {percent(over_places(list(passed)))}')
    if films is None:
        return
    films.mkdir(parents=True, exist_ok=True)
    failed = rows[(rows.outcome == 'FAIL') & (rows.light == 'day')].sort_values('rho')
    for _, row in failed.groupby('runway', sort=False).head(1).iterrows():
        film(folder / row.run_id, films / f'{row.run_id}.mp4')


print_tables(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else None)
