"""How much wind the steering law stands, on a dry, a wet and an icy runway: a table of shares.

Each cell has the same random starts, those of S_falsif, with wind from any side and gusts whose
standard deviation is a fifth of its speed; the steering law is given the true state::

    python examples/wind_table.py --runs 100
    python examples/wind_table.py --runs 100 --speed 3
"""

import argparse
import math
import random

import taxinet_ros as tx
from taxinet_ros.campaign.rates import rate

WINDS_MPS = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)
STATES = ('dry', 'wet', 'icy')


def scene(number: int, wind_mps: float, state: str, speed_mps: float) -> tx.Scenario:
    """Start ``number``, in one cell of the table."""
    draw = random.Random(number)
    start = {
        'cross_track_m': draw.uniform(-8, 8), 'distance_m': draw.uniform(0, 2000),
        'heading_rad': math.radians(draw.uniform(-30, 30)),
    }
    wind = {
        'wind_speed_mps': wind_mps, 'wind_direction_rad': draw.uniform(0, 2 * math.pi),
        'gust_mps': wind_mps / 5, 'gust_seed': float(number),
    }
    return tx.Scenario(
        **start, **(wind if wind_mps else {}), runway_state=state, speed_mps=speed_mps,
    )


def cell(runs: int, wind_mps: float, state: str, speed_mps: float) -> str:
    """Share that satisfies phi_eventually, with its 95 % interval, and that leaves the runway."""
    results = [
        tx.run(scene(number, wind_mps, state, speed_mps), perception='truth')
        for number in range(runs)
    ]
    passed = sum(run.outcome is tx.Outcome.PASS for run in results)
    off = sum(run.statistics.left_runway for run in results)
    share, low, high = (100 * value for value in rate(passed, runs))
    left = f', {100 * off / runs:.0f} % off' if off else ''
    return f'{share:.0f} % ({low:.0f}-{high:.0f}){left}'


def main() -> None:
    """Print the table, row by row."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('--runs', type=int, default=1, help='in each cell')
    parser.add_argument('--speed', type=float, default=5.0, help='taxi speed [m/s]')
    given = parser.parse_args()
    print('| runway | ' + ' | '.join(f'{wind:g} m/s' for wind in WINDS_MPS) + ' |')
    print('| --- |' + ' --- |' * len(WINDS_MPS))
    for state in STATES:
        cells = [cell(given.runs, wind, state, given.speed) for wind in WINDS_MPS]
        print(f'| {state} | ' + ' | '.join(cells) + ' |', flush=True)


if __name__ == '__main__':
    main()
