"""How much wind the steering law tolerates with the truth or a network, on three surfaces."""

import math
import random
import sys

import taxinet_ros as tx
from taxinet_ros.trials.rates import rate

WINDS_MPS = (0.0, 5.0, 10.0, 15.0, 20.0, 25.0)
RUNS, SPEED_MPS = map(float, sys.argv[1:3] if sys.argv[2:] else ('1', '5'))
print('| runway |', ' | '.join(f'{wind:g} m/s' for wind in WINDS_MPS), '|\n' + '| --- ' * 7 + '|')
for state in ('dry', 'wet', 'icy'):
    print(f'| {state} |', end=' ')
    for wind in WINDS_MPS:
        passed = off = 0
        for number in range(int(RUNS)):
            draw = random.Random(number)  # the same starts, those of S_falsif, in every cell
            scene = {'cross_track_m': draw.uniform(-8, 8), 'distance_m': draw.uniform(0, 2000),
                     'heading_rad': math.radians(draw.uniform(-30, 30)),
                     'runway_state': state, 'speed_mps': SPEED_MPS}
            if wind:
                scene |= {'wind_speed_mps': wind, 'wind_direction_rad': draw.uniform(0, math.tau),
                          'gust_mps': wind / 5, 'gust_seed': float(number)}
            run = tx.run(tx.Scenario(**scene), perception=(*sys.argv[3:], 'truth')[0])
            passed, off = passed + (run.outcome == 'PASS'), off + run.statistics.left_runway
        share, low, high = (f'{100 * part:.0f}' for part in rate(passed, int(RUNS)))
        left = f', {100 * off / RUNS:.0f} % off' if off else ''
        print(f'{share} % ({low}-{high}){left}', end=' | ', flush=True)
    print()
