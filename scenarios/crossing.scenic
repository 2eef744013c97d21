"""S_falsif restricted to starts around the crossing (paper, appendix on iterative retraining)."""
model runway_world

param time_of_day_h = Range(6, 18)

weather = Options({
    (Uniform(*CLOUDS), 0): 2,
    (Uniform(*RAIN_CLOUDS), Range(25, 100)): 1,
})
param clouds = weather[0]
param rain_percent = weather[1]

# The crossing is near 1450 m.
ego = new Plane at (Range(-8, 8), Range(1350, 1550)), facing Range(-30, 30) deg
