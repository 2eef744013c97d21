"""How the shipped network copes with others on the ground, 50 to 70 m ahead: a table."""

import math
import random
import sys

import taxinet_ros as tx
from taxinet_ros.campaign.rates import rate

AHEAD = {  # of each: its kind, and where it is left of the centreline [m]
    'nobody': {}, 'a cone': {'cone': 5}, 'a person': {'person': 7}, 'a van': {'vehicle': 9},
    'a parked aircraft': {'aircraft': -22}, 'a van that crosses': {'vehicle': 25},
    'a closed marking (X)': {'closed_marking': 0}, 'tyre marks': {'tyre_marks': -3},
    'a patch': {'patch': -4}, 'a painted-over centreline': {'painted_over': 0},
}
RUNS = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 1
print('| ahead | satisfies `phi_eventually` | hits it |\n| --- | --- | --- |')
for name, objects in AHEAD.items():
    passed = hit = 0
    for number in range(RUNS):
        draw = random.Random(number)  # the same starts in every row
        start = {'cross_track_m': draw.uniform(-8, 8), 'distance_m': draw.uniform(0, 1350)}
        start |= {'heading_rad': math.radians(draw.uniform(-20, 20))}
        start |= {'time_of_day_s': 3600 * draw.uniform(10, 16)}
        x_m = start['distance_m'] + draw.uniform(50, 70)
        there = [{'kind': kind, 'x_m': x_m, 'y_m': y_m} for kind, y_m in objects.items()]
        if 'crosses' in name:
            there[0]['path'] = [{'x_m': x_m, 'y_m': -there[0]['y_m'], 'speed_mps': 4}]
        traffic = tx.load_traffic(there) if there else ''
        run = tx.run(tx.Scenario(**start, traffic=traffic), perception='taxinet')
        passed += run.outcome == 'PASS'
        hit += any(step.clearance_m <= 0 for step in run.steps)
    shares = ('{:.0f} % ({:.0f}-{:.0f})'.format(*(100 * part for part in rate(count, RUNS)))
              for count in (passed, hit))
    print('|', ' | '.join([name, *shares]), '|', flush=True)
