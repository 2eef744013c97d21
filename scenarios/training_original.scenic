"""The narrow world in which the original TaxiNet learns to see.

Its gaps are deliberate, and they are what falsification has to find (paper, section 3.3): no early
morning, no afternoon and so no shadow in front of the aircraft, no rain and no rain-dark sky, and
no picture taken at the crossing near 1450 m. Positions reach a little beyond those of S_falsif, so
that the network need not extrapolate at the rim.
"""
model runway_world

param time_of_day_h = Range(8.5, 12)
param clouds = Uniform('clear', 'cirrus', 'scattered', 'overcast')
param rain_percent = 0

# Weighted by length, so that every metre is equally likely.
distance_m = Options({Range(0, 1300): 1300, Range(1600, 2400): 800})
ego = new Plane at (Range(-9, 9), distance_m), facing Range(-32, 32) deg
