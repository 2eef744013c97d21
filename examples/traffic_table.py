"""How the shipped network copes with another on the ground, 50 to 70 m ahead: a table."""

import math
import random
import sys

import taxinet_ros as tx
from taxinet_ros.trials.rates import rate

AHEAD = {  # its kind, and where it is left of the centreline [m]
    'nobody near': ('cone', 999), 'a cone': ('cone', 5), 'a person': ('person', 7),
    'a van': ('vehicle', 9),
    'a parked aircraft': ('aircraft', -22), 'a van that crosses': ('vehicle', 25),
    'a closed marking (X)': ('closed_marking', 0), 'tyre marks': ('tyre_marks', -3),
    'a patch': ('patch', -4), 'a painted-over centreline': ('painted_over', 0),
}
RUNS = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 1
for name, (kind, y_m) in AHEAD.items():
    ends = []
    for draw in map(random.Random, range(RUNS)):  # the same starts in every row
        start = {'cross_track_m': draw.uniform(-8, 8), 'distance_m': draw.uniform(0, 1350)}
        start['heading_rad'] = math.radians(draw.uniform(-20, 20))
        start['time_of_day_s'] = 3600 * draw.uniform(10, 16)
        one = {'kind': kind, 'y_m': y_m, 'x_m': start['distance_m'] + draw.uniform(50, 70)}
        if 'crosses' in name:
            one['path'] = [{'x_m': one['x_m'], 'y_m': -y_m, 'speed_mps': 4}]
        scene = tx.Scenario(**start, traffic=tx.load_traffic([one]))
        ends.append(tx.run(scene, perception='taxinet').outcome == 'PASS')
    print('| {} | {:.0f} % ({:.0f}-{:.0f}) |'.format(
        name, *(100 * part for part in rate(sum(ends), RUNS))), flush=True)
