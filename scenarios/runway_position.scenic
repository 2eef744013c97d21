"""S_falsif with the start of the runway and the crossing over-represented (paper, Fig. 8).

Made for retraining: the comments give each range's share in S_falsif.
"""
model runway_world

param time_of_day_h = Range(6, 18)

weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

distance_m = Options({
    Range(0, 400): 0.35,      # 0.2
    Range(400, 1200): 0.1,    # 0.4
    Range(1200, 1600): 0.5,   # 0.2, the crossing is near 1450 m
    Range(1600, 2000): 0.05,  # 0.2
})
ego = new Plane at (Range(-8, 8), distance_m), facing Range(-30, 30) deg
