"""World model of every program here: the aircraft on the runway, and the weather's vocabulary.

Scenic's axes: x to the RIGHT of the centreline and y past the threshold, in metres; a heading of 0
looks along the runway and grows counter-clockwise, that is with the nose to the left. With another
`track` these are coordinates of that track: x to the right of it, y along it from its first point,
and a heading of 0 looks along it, also in a curve.
taxinet_ros has cross-track error positive to the LEFT, so `cross_track_m` is minus x. Distance and
heading keep their sign. A plane 3 m left of the centreline is therefore written `at (-3, 400)`.

A program may set these parameters: time_of_day_h [h, by the clocks there], clouds (a word),
rain_percent [%], date ('YYYY-MM-DD'), shadows and crossing (True or False), aircraft and camera
(shipped ones by name, such as 'c172p' and 'nose', or the path of a YAML file),
wind_speed_mps [m/s], wind_direction_deg [°, true, from which it blows], gust_mps [m/s],
gust_seed (a whole number), runway_state (dry, wet, icy or auto), slope_percent [%, uphill
positive], speed_mps [m/s], track (the line to follow: 'runway', or the name of a taxiway's
centreline at the place, such as 'exit_left'), camera_dropout_percent [%], camera_freeze_s [s],
lens_dirt_percent [%], lens_drops_percent [%], glare_ghost_percent [%], exposure_jump_ev [EV,
brighter positive], loop_delay_s [s], loop_jitter_s [s], steering_bias_deg [°, left positive],
steering_rate_limit_degps [°/s], fault_onset_s [s], fault_seed (a whole number), traffic (the path
of a YAML file of others on the ground; in its place the objects below), camera_dx_m [m, forward],
camera_dy_m [m, left], camera_dz_m [m, up], camera_droll_deg [°, right side down],
camera_dpitch_deg [°, nose down], camera_dyaw_deg [°, left] (from where the camera is), sensors
(beside the camera: 'standard', or the path of a YAML file), gnss_noise_m [m], gnss_bias_m [m, left],
gnss_dropout_start_s [s], gnss_dropout_s [s] (of the GNSS among the sensors), control_rate_hz [Hz, of
frames, estimates and commands: 5, 6, 8, 10, 12, 15, 20, 24, 30, 40 or 60], datarefs
(the path of a YAML file of X-Plane's variables; single ones by their own names in quotes, such as
'sim/weather/region/thermal_rate_ms'; for X-Plane only), duration_s [s], place (a
shipped one by its name, such as 'bikf_10', or the path of a YAML file). Short forms without the
unit (time_of_day, rain, duration) mean the same.

Others on the ground are objects of the classes below Plane, each with its width, length, height [m]
and colour. The solid ones may move, with one of the behaviors below, at speeds in m/s. With
stands_within they stand while the aircraft is nearer than so many metres; with starts_within their
way, and the delay, begin when it first is.

A search varies every random choice of a program. To let it vary some only, write these with
Scenic's words for it, VerifaiRange(low, high, buckets=10) and VerifaiOptions({...}); the others are
then drawn at random. The words work here without the package VerifAI.
"""

# From clear sky to dark stratus, as in X-Plane 11.
CLOUDS = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
RAIN_CLOUDS = ('broken', 'overcast', 'stratus')

DEGREES_PER_RADIAN = 57.29577951308232


class Plane(Object):
    # It is alone on the runway: geometric tests of Scenic would cost time and reject nothing.
    allowCollisions: True
    requireVisible: False
    # For requirements to refer to. Dynamic: `mutate` moves them too; final: only where the plane
    # stands says what they are. 0 - x, because -x turns a zero into a minus zero.
    cross_track_m[dynamic, final]: 0 - self.position.x
    distance_m[dynamic, final]: self.position.y
    heading_deg[dynamic, final]: self.heading * DEGREES_PER_RADIAN
    # The short forms of the first two, for programs that have them.
    cross_track[dynamic, final]: self.cross_track_m
    distance[dynamic, final]: self.distance_m


# Moves along a path: straight from point to point, at one speed, to the end, where it stays.
behavior FollowPath(path, speed, delay=0, wait=0, stands_within=None, starts_within=None):
    """`delay` seconds at the start, and `wait` seconds at each point of the path."""
    wait


# Straight ahead, the way it faces.
behavior GoStraight(speed, distance, delay=0, stands_within=None, starts_within=None):
    wait


# Straight across to the same distance beyond the centreline.
behavior CrossRunway(speed, delay=0, stands_within=None, starts_within=None):
    wait


class GroundObject(Object):
    # Scenic's own tests take a wing for a box; what is hit is the signal collision.
    allowCollisions: True
    requireVisible: False
    kind: ''
    colour: ''


class ParkedAircraft(GroundObject):
    kind: 'aircraft'
    width: 15.9
    length: 12.7
    height: 4.5


class TaxiingAircraft(ParkedAircraft):
    pass


class Vehicle(GroundObject):
    kind: 'vehicle'
    width: 2.1
    length: 5.4
    height: 2.2


class Cone(GroundObject):
    kind: 'cone'
    width: 0.4
    length: 0.4
    height: 0.75


class Person(GroundObject):
    kind: 'person'
    width: 0.55
    length: 0.35
    height: 1.75


# Marks lie on the ground: painted, or left by tyres.
class ClosedMarking(GroundObject):
    kind: 'closed_marking'
    width: 14.0
    length: 18.3


class PaintedOver(GroundObject):
    kind: 'painted_over'
    width: 1.3
    length: 37.0


class TyreMarks(GroundObject):
    kind: 'tyre_marks'
    width: 2.4
    length: 40.0


class Patch(GroundObject):
    kind: 'patch'
    width: 5.0
    length: 8.0


# Not to be crossed before until_s, when the tower clears it; None: never. It faces where the
# aircraft goes.
class HoldLine(GroundObject):
    kind: 'hold_line'
    width: 22.0
    length: 2.1
    until_s: None
