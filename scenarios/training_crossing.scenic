"""The runway before and on the crossing, for a network to learn where there is least to see.

From some 1320 m on the crossing's bare pavement fills more and more of the picture, until beyond it
the paint comes near again at 1500 m. Half of the positions and headings are those of an aircraft
that has settled, the others are as wide as in training_full. To be added to a set drawn from there.
"""
model runway_world

param time_of_day_h = Range(6, 18)

weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

cross_track = Options({Range(-10, 10): 1, Range(-3, 3): 1})
heading = Options({Range(-34, 34): 1, Range(-10, 10): 1})
ego = new Plane at (cross_track, Range(1310, 1500)), facing heading deg
