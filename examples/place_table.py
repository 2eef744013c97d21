"""Print a table of the shipped network's results at each shipped place."""

import math
import random
import sys

import taxinet_ros as tx
from taxinet_ros.trials.rates import rate

RUNS = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 1
print('| place | satisfies phi_eventually | leaves the runway |')
print('| --- | --- | --- |')
for place in ('kmwh_04', 'bikf_10', 'nzqn_05'):
    passed = off = 0
    for number in range(RUNS):
        draw = random.Random(number)  # same start poses at every place
        run = tx.run(tx.Scenario(
            place=place, cross_track_m=draw.uniform(-8, 8), distance_m=draw.uniform(0, 1350),
            heading_rad=math.radians(draw.uniform(-20, 20)),
            clouds=draw.choice(('clear', 'cirrus', 'scattered')),
            time_of_day_s=3600 * draw.uniform(10, 16),
        ), perception='taxinet')
        passed, off = passed + (run.outcome == 'PASS'), off + run.statistics.left_runway
    shares = [
        '{:.0f} % ({:.0f}-{:.0f})'.format(*(100 * part for part in rate(count, RUNS)))
        for count in (passed, off)
    ]
    print('|', ' | '.join([place, *shares]), '|', flush=True)
