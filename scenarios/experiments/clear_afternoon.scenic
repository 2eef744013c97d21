"""A clear, dry afternoon, from starts of S_falsif that are away from the crossing.

For the experiment shadows_afternoon.yaml: at these hours the aircraft's own shadow lies before the
camera, and 30 s of taxiing end before the crossing comes into view.
"""
model runway_world

param time_of_day_h = Range(12.25, 17.75)
param clouds = 'clear'
param rain_percent = 0

ego = new Plane at (Range(-8, 8), Range(0, 1000)), facing Range(-30, 30) deg
