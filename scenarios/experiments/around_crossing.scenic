"""Starts from well before the crossing to well beyond it, late in the morning in fine weather.

For the experiment crossing.yaml: light and weather in which the networks do well elsewhere.
"""
model runway_world

param time_of_day_h = Range(9.5, 11.5)
param clouds = Uniform('clear', 'cirrus', 'scattered')
param rain_percent = 0

# The crossing is near 1450 m.
ego = new Plane at (Range(-8, 8), Range(1100, 1700)), facing Range(-30, 30) deg
