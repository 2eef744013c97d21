"""The generic falsification scenario S_falsif (paper, section 3.2 and Fig. 3).

All of daylight, all of the weather, and every start from which the centreline can be reached
within ten seconds.
"""
model runway_world

param time_of_day_h = Range(6, 18)

# Clouds and rain are drawn together: two times in three it is dry under any sky, else it rains
# from a sky that can rain. Below 25 % X-Plane shows no rain.
weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

ego = new Plane at (Range(-8, 8), Range(0, 2000)), facing Range(-30, 30) deg
