"""The scenes of `anywhere` at 40 of the places that networks are trained on.

They say what a network is used to: for `taxinet assure calibrate`.
"""
model runway_world

from taxinet_ros.core.place.random_place import SPLITS

param place = Uniform(*[f'random:{number}' for number in SPLITS['train'][:40]])
param time_of_day_h = Range(6, 18)

weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

param start_percent = Range(0, 100)
ego = new Plane at (Range(-8, 8), 0), facing Range(-30, 30) deg
