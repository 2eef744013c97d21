"""A mission with a hold line: taxi to it, stop until the tower clears it, and go on.

For `--controller hold_short --spec hold_short`. The line is on the taxiway that leaves the runway
at 90 degrees, so a bias of the GNSS to the left of the runway is one along the taxiway.
"""
model runway_world

param track = 'exit_left'
param runway_state = Uniform('dry', 'wet')
param sensors = 'standard'
param gnss_noise_m = Range(0.5, 2)
param gnss_bias_m = Range(-4, 4)
param gnss_dropout_start_s = Range(0, 20)
param gnss_dropout_s = Range(1, 15)
param fault_seed = DiscreteRange(1, 1000)
param duration_s = 60

ego = new Plane at (0, 280)
new HoldLine at (0, Range(370, 420)), with until_s Range(25, 45)
