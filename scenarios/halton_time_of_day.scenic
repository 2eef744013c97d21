"""Nothing but the time of day (paper, Fig. 7), to be spread evenly with the Halton sampler.

Under a clear sky, from one place on the centreline and straight ahead: the spot lies beyond the
rubber of the touchdown zone, and 30 s of taxiing end before the crossing. Run it once as it is and
once with `--set shadows=off`: what differs is the aircraft's shadow.
"""
model runway_world

param time_of_day_h = Range(6, 18)
param clouds = 'clear'
param rain_percent = 0

ego = new Plane at (0, 1000)
