"""S_falsif at any place, which --set or another program's `param place` names.

All of daylight, all of the weather, and the whole runway, whatever its length.
"""
model runway_world

param time_of_day_h = Range(6, 18)

# Clouds and rain are drawn together, as in S_falsif.
weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

# 0 is the runway's threshold, 100 the last start from which a run ends before the runway does.
param start_percent = Range(0, 100)
ego = new Plane at (Range(-8, 8), 0), facing Range(-30, 30) deg
