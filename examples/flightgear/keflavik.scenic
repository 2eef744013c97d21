"""The form of S_falsif (paper, section 3.2) at Keflavík, where FlightGear has terrain.

All of daylight there at the equinox, all of the weather, and every start from which the centreline
can be reached within ten seconds.
"""
model runway_world

param place = 'bikf_10'
param time_of_day_h = Range(7.5, 19.5)

weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

ego = new Plane at (Range(-8, 8), Range(0, 2000)), facing Range(-30, 30) deg
