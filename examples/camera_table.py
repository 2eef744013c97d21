"""Print a table of the shipped network's results with other cameras and aircraft."""

import math
import random
import sys

import taxinet_ros as tx
from taxinet_ros.trials.rates import rate

RUNS = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 1
RIGS = (('wing', 'caravan'), ('nose', 'caravan'), ('wing', 'c172p'), ('strut', 'c172p'))
print('| camera | aircraft | satisfies phi_eventually | leaves the runway |')
print('| --- | --- | --- | --- |')
for camera, aircraft in RIGS:
    passed = off = 0
    for number in range(RUNS):
        draw = random.Random(number)  # same start poses for every rig
        run = tx.run(tx.Scenario(
            camera=camera, aircraft=aircraft, cross_track_m=draw.uniform(-8, 8),
            distance_m=draw.uniform(0, 1350), heading_rad=math.radians(draw.uniform(-20, 20)),
            time_of_day_s=3600 * draw.uniform(10, 16),
        ), perception='taxinet')
        passed, off = passed + (run.outcome == 'PASS'), off + run.statistics.left_runway
    shares = [
        '{:.0f} % ({:.0f}-{:.0f})'.format(*(100 * part for part in rate(count, RUNS)))
        for count in (passed, off)
    ]
    print('|', ' | '.join([camera, aircraft, *shares]), '|', flush=True)
