"""The whole world of S_falsif for a network to learn in, and a little beyond its rim.

All hours, all of the weather, the whole runway with its crossing. Positions and headings reach
beyond those of S_falsif, so that the network need not extrapolate when the aircraft overshoots.
"""
model runway_world

param time_of_day_h = Range(6, 18)

weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

# The crossing, where there is least to see, gets three times its share.
distance_m = Options({Range(0, 1300): 1300, Range(1300, 1600): 900, Range(1600, 2400): 800})
ego = new Plane at (Range(-10, 10), distance_m), facing Range(-34, 34) deg
