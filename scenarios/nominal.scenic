"""Plain taxiing: on the centreline, late in the morning, in fine weather.

Both stretches lie beyond the rubber of the touchdown zone, and a run of 30 s (some 150 m) from
anywhere in them ends before the crossing near 1450 m or starts after it. For the specification
phi_always, which demands the centreline from the first moment.
"""
model runway_world

param time_of_day_h = Range(9.5, 11.5)
param clouds = Uniform('clear', 'cirrus', 'scattered')
param rain_percent = 0

# Weighted by length, so that every metre is equally likely.
distance_m = Options({Range(950, 1150): 200, Range(1650, 1950): 300})
ego = new Plane at (Range(-0.5, 0.5), distance_m), facing Range(-3, 3) deg
