"""S_falsif as the prior of a cross-entropy search (paper, end of section 3.4).

The scenes are those of S_falsif; what is added is into how many equal parts each range is cut for
the histogram that the search learns. The distances get parts of 200 m, in which the paper tells
what it learned: 79 % in 1400-1600 m, 16 % in 1200-1400 m, 5 % in 0-200 m.
"""
model runway_world

param time_of_day_h = VerifaiRange(6, 18, buckets=12)

weather = VerifaiOptions({
    (VerifaiOptions(CLOUDS), 0): 2,
    (VerifaiOptions(RAIN_CLOUDS), VerifaiRange(25, 100, buckets=3)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

cross_track_m = VerifaiRange(-8, 8, buckets=8)
distance_m = VerifaiRange(0, 2000, buckets=10)
ego = new Plane at (cross_track_m, distance_m), facing VerifaiRange(-30, 30, buckets=6) deg
