"""S_falsif with the wing camera moved by up to 0.3 m along and 3° about each axis.

For networks that see through the virtual camera (docs/networks.md).
"""
model runway_world

param camera_dx_m = Range(-0.3, 0.3)
param camera_dy_m = Range(-0.3, 0.3)
param camera_dz_m = Range(-0.3, 0.3)
param camera_droll_deg = Range(-3, 3)
param camera_dpitch_deg = Range(-3, 3)
param camera_dyaw_deg = Range(-3, 3)


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
