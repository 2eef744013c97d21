"""Every construct of Scenic either has its effect on a run, or is refused by name and line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taxinet_ros.core.scenario_fields import by_key

MODEL = 'model runway_world\n'
PLANE = MODEL + 'ego = new Plane at (Range(-1, 1), 400)\n'
AT = MODEL + 'ego = new Plane at (1, 400)'

Ask = Callable[..., dict[str, Any]]


@pytest.fixture
def ask(client: Any, compiled: Any, tmp_path: Path) -> Ask:
    """What is said of a program: an error or, where it compiles, its scenes."""

    def answer(text: str, *, scenes: int = 1, **files: str) -> dict[str, Any]:
        for name, other in files.items():
            (tmp_path / f'{name}.scenic').write_text(other)
        said = compiled(text)
        drawn = []
        for index in range(scenes):
            if 'error' in said:
                return said
            said = client.ask(op='scene', index=index)
            drawn.append(said.get('values'))
        return {'error': said['error']} if 'error' in said else {'scenes': drawn}

    return answer


def spot(draw: str, before: str = '') -> str:
    return f'{MODEL}{before}\nego = new Plane at (0, {draw})\nparam rain = 0\n'


NP = 'import numpy as np'
TWICE = 'compiled twice, distance_m is '
REFUSED = {
    'with behavior': (MODEL + 'from library import Drive\n' + AT[len(MODEL):]
                      + ',\n    with behavior Drive()\n', 3,
                      'behavior has no effect here: the controller'),
    'behavior of a class': (
        MODEL + 'from library import Drive\nclass Own(Plane):\n    behavior: Drive()\n'
        'ego = new Own at (0, 400)\n', 5, 'behavior has no effect here: the controller'),
    'require monitor': (PLANE + 'from library import Watch\nrequire monitor Watch()\n', 4,
                        'require monitor has no effect here: a scene says how a run begins'),
    'compose': ('scenario Main():\n    setup:\n        model runway_world\n', 3,
                'Cannot use "model" inside'),
    'compose block': (
        MODEL + 'scenario Main():\n    setup:\n        ego = new Plane at (0, 400)\n'
        '    compose:\n        wait\n', 2,
        'compose, precondition or invariant has no effect here: each run is one scene'),
    'precondition': (
        MODEL + 'scenario Main():\n    precondition: 1 > 2\n    setup:\n'
        '        ego = new Plane at (0, 400)\n', 2, 'compose, precondition or invariant has no'),
    'invariant': (
        MODEL + 'scenario Main():\n    invariant: 1 > 2\n    setup:\n'
        '        ego = new Plane at (0, 400)\n', 2, 'compose, precondition or invariant has no'),
    'compose of a library': (MODEL + 'from library import Main\n', 19,
                             'compose, precondition or invariant has no effect here'),
    'require always': (PLANE + 'require always ego.position.x < 1\n', 3,
                       'require always has no effect here: a scene says how a run begins'),
    'require eventually': (PLANE + 'require eventually ego.position.x > 99\n', 3,
                           'require eventually has no effect'),
    'require until': (PLANE + 'require (ego.position.x > 9) until (ego.position.y > 3)\n', 3,
                      'require until has no effect'),
    'record': (PLANE + 'record ego.position\n', 3, 'record has no effect here: the bag'),
    'record of a library': (PLANE + 'from library import keep\nkeep()\n', 17,
                            'record has no effect'),
    'terminate when': (PLANE + 'terminate when ego.position.x > 3\n', 3, 'terminate when has no'),
    'terminate simulation when': (PLANE + 'terminate simulation when 1 > 0\n', 3,
                                  'terminate simulation when has no effect here: a run ends'),
    'terminate after': (PLANE + 'terminate after 5 seconds\n', 3,
                        'terminate after has no effect here: a run ends after "param duration_s"'),
    'simulator of a model': (
        'model scenic.simulators.newtonian.model\nego = new Object at (0, 400)\n', 1,
        'simulator has no effect here: the graph'),
    'override': (PLANE + 'override ego with speed 3\n', 3, 'override has no effect here'),
    'wait': (PLANE + 'wait\n', 3, 'Cannot use "Wait"'),
    'overrides that are none': (PLANE + 'param overrides = 3\n', 3, 'param overrides: expected'),
    'overrides by chance': (
        PLANE + "param overrides = {'clouds': Uniform('clear', 'stratus')}\n", 3,
        'param overrides: expected fixed values by key'),
    'override of no key': (PLANE + "param overrides = {'cloud': 'clear'}\n", 3,
                           "param overrides: override cloud=clear: unknown key 'cloud'"),
    'second plane': (PLANE + '\nsecond = new Plane at (0, 600)\n', 4, 'a further Plane: it is no'),
    'truck ahead': (
        PLANE + 'class Truck:\n    width: 3\nnew Truck ahead of ego by Range(5, 50)\n', 5,
        'a further Truck: it is no ground object of runway_world (ParkedAircraft, Vehicle, …)'),
    'ego assigned twice': (PLANE + 'ego = new Plane at (0, 600)\n', 2, 'a further Plane'),
    'object of a library': (PLANE + 'from library import cone\ncone()\n', 14, 'a further Object'),
    'speed': (AT + ', with speed 5\n', 2, 'speed has no effect here: write "param speed_mps"'),
    'angular speed': (AT + ', with angularSpeed 1\n', 2, 'angularSpeed has no effect'),
    'altitude': (MODEL + 'ego = new Plane at (0, 400, 5)\n', 2,
                 'an altitude of 5 m has no effect here: the aircraft stands on its wheels'),
    'random altitude': (MODEL + 'ego = new Plane at (0, 400, Range(0, 1))\n', 0,
                        'an altitude of'),
    'altitude in a box': (MODEL + 'ego = new Plane in BoxRegion(dimensions=(9, 9, 9))\n', 0,
                          'an altitude of'),
    'pitch': (AT + ', with pitch 5 deg\n', 2, 'a pitch of 5 deg has no effect here'),
    'roll': (AT + ', with roll 5 deg\n', 2, 'a roll of 5 deg has no effect here'),
    'leaning region': (AT + ', facing Orientation.fromEuler(0, 0, 5 deg)\n', 2, 'a roll of 5 deg'),
    'with cross_track': (AT + ', with cross_track 5\n', 2,
                         'property "cross_track" cannot be directly specified'),
    'contradicting model': (
        'class Jet:\n    cross_track: 5\n    distance: self.position.y\n    heading_deg: 0\n'
        'ego = new Jet at (0, 400)\n', 0,
        'cross_track_m is 5, but where the aircraft stands it is'),
    'position twice': (MODEL + 'ego = new Plane at (0, 400), with position (1, 2)\n', 2,
                       'property "position" specified twice'),
    'colour': (AT + ', with color (1, 0, 0)\n', 2, 'color has no effect here: the look'),
    'typo': (AT + ', with yoll 3 deg\n', 2,
             'with yoll: no property of Plane, so it has no effect; did you mean roll?'),
    'mutation scale': (AT + ', with mutationScale 2\n', 2, 'mutationScale: has no effect here'),
    'sensors': (AT + ', with sensors {"a": 1}\n', 2, 'sensors has no effect here'),
    'param with a typo': (PLANE + 'param shadow = False\n', 3,
                          'param shadow: unknown, so it has no effect; did you mean shadows?'),
    'param of a sampler with a typo': (PLANE + 'param verifaiSamplerTyp = "ce"\n', 3,
                                       'param verifaiSamplerTyp: unknown'),
    'param of a library': (PLANE + 'import library2\n', 1, 'param fog: unknown'),
    'clouds of X-Plane': (PLANE + 'param clouds = Uniform("clear", 3)\n', 3,
                          "param clouds is '3', not one of clear, cirrus, scattered"),
    'param of the plane': (PLANE + 'param heading = 3\n', 3, "parameter 'heading' belongs to the"),
    'param in both forms': (PLANE + 'param rain_percent = 0\nparam rain = 5\n', 4,
                            'param rain and param rain_percent are the same; leave one out'),
    'param of the plane with its unit': (PLANE + 'param distance_m = 3\n', 3,
                                         "parameter 'distance_m' belongs to the plane"),
    'own external sampler': (
        PLANE + 'from scenic.core.external_params import ExternalSampler\n'
        'param externalSampler = ExternalSampler\n', 4, 'externalSampler: a sampler of the'),
    'rejection feedback': (PLANE + 'param externalSamplerRejectionFeedback = False\n', 3,
                           'externalSamplerRejectionFeedback is False; it has to be a number'),
    'rejection feedback of no number': (
        PLANE + 'param externalSamplerRejectionFeedback = float("nan")\n', 3,
        'externalSamplerRejectionFeedback is nan; it has to be a number'),
    'attack: switch': (PLANE + 'param shadows = Uniform("on", "maybe")\n', 3,
                       "param shadows needs on or off, got 'maybe'"),
    'attack: rare word': (PLANE + 'param clouds = Options({"clear": 999, "cloudy": 1})\n', 3,
                          "param clouds is 'cloudy', not one of"),
    'attack: aircraft': (PLANE + 'param aircraft = Uniform("default", "jumbo")\n', 3,
                         'param aircraft'),
    'attack: word of a pair': (
        PLANE + 'w = Uniform(("clear", 0), ("brokn", 9))\nparam clouds = w[0]\n', 4,
        "param clouds is 'brokn'"),
    'attack: date': (PLANE + 'param date = Uniform("2026-06-01", "June")\n', 3, 'param date'),
    'attack: DotMap': (PLANE + 'param verifaiSamplerParams = DotMap(alpha=0.9)\n', 3,
                       "NameError: name 'DotMap' is not defined; a dict does as well"),
    'attack: deviation': (MODEL + 'ego = new Plane at (Normal(0, -3), 400)\n', 2,
                          'ValueError: the standard deviation of a Normal is -3; it has to be'),
    'several scenarios': (
        MODEL + 'scenario A():\n    setup:\n        ego = new Plane at (0, 4)\nscenario B():\n'
        '    setup:\n        ego = new Plane at (0, 5)\n', 0,
        'there are several scenarios; call the one to be run Main'),
    'assigned: speed': (PLANE + 'ego.speed = 9\n', 2, 'speed of the Plane is set when'),
    'assigned: pitch': (
        PLANE + 'ego.pitch = 0.3\n', 2,
        'pitch of the Plane is set when the object is made already'),
    'assigned: a typo': (PLANE + 'ego.distnace = 7\n', 2, 'distnace of the Plane is set when'),
    'assigned: heading_deg': (
        PLANE + 'ego.heading_deg = 3\n', 2, 'heading_deg of the Plane is set when'),
    'assigned: in a function': (
        PLANE + 'def turn(thing):\n    thing.yaw = 1\nturn(ego)\n', 2,
        'yaw of the Plane is set when'),
    'assigned: a coordinate': (
        PLANE + 'ego.position.x = 3\n', 3, "AttributeError: property 'x' of 'Vector'"),
    'chance: uniform': (spot('random.uniform(0, 2000)', 'import random'), 3, TWICE),
    'chance: choice': (
        spot('random.choice([3, 4])', 'import random'), 0,
        'compiled twice, it draws from random without a seed of its own: chance outside Scenic'),
    'chance: in a function': (
        spot('draw()', 'import random\ndef draw():\n    return random.random()'), 5, TWICE),
    'chance: numpy': (spot('400', NP) + 'param duration = 3 + np.random.rand()', 5,
                      'compiled twice, duration is '),
    'chance: default_rng': (spot('np.random.default_rng().uniform(0, 9)', NP), 3, TWICE),
    'chance: time': (spot('perf_counter() % 2000', 'from time import perf_counter'), 3, TWICE),
    'chance: uuid': (spot('uuid.uuid4().int % 999', 'import uuid'), 3, TWICE),
    'chance: a clock for each scene': (
        'from scenic.core.distributions import distributionFunction\nimport time\n'
        '@distributionFunction\ndef half(x):\n    return time.monotonic()\n' + MODEL
        + 'ego = new Plane at (half(Range(1, 2)), 400)\n', 7,
        'compiled twice, cross_track_m is '),
    'chance: library': (spot('library4.X', 'import library4'), 3, TWICE),
    'chance: an order of addresses': (
        MODEL + 'import math\nown = {object(): number for number in range(9999)}\n'
        'ego = new Plane at (0, hash(tuple(own[one] for one in set(own))) % 1999)\n', 4, TWICE),
    'record beside a scenario': (
        PLANE + 'record ego.position\nscenario Main():\n    setup:\n        param duration = 5\n',
        3, 'record has no effect here'),
    'terminate of a module': (PLANE + 'import ending\n', 1, 'terminate when has no effect here'),
    'monitor of a module': (PLANE + 'import watching\n', 3, 'require monitor has no effect here'),
    'width': (AT + ', with width 3\n', 2, 'width has no effect here: no region, requirement or'),
    'length of a class': (
        MODEL + 'class Own(Plane):\n    length: 9\nego = new Own at (0, 400)\n', 4,
        'length has no effect here'),
    'shape': (AT + ', with shape CylinderShape()\n', 2, 'shape has no effect here'),
    'shape of a ground object': (
        PLANE + 'new Vehicle at (3, 450), with shape CylinderShape()\n', 3, 'shape has no effect'),
    'height of what is flat': (PLANE + 'new Patch at (3, 450), with height 2\n', 3,
                               'height has no effect here'),
    'contact': (AT + ', with contactTolerance 3\n', 2, 'contactTolerance has no effect here'),
    'view angle': (AT + ', with viewAngle 60 deg\n', 2, 'viewAngle has no effect here: nothing'),
    'visible distance': (AT + ', with visibleDistance 9\n', 2, 'visibleDistance has no effect'),
    'camera offset': (AT + ', with cameraOffset (1, 0, 2)\n', 2, 'cameraOffset has no effect'),
    'occluding': (AT + ', with occluding False\n', 2, 'occluding has no effect here'),
    'collisions of one': (AT + ', with allowCollisions False\nnew Cone at (0, 450)\n', 2,
                          'allowCollisions has no effect here'),
    'visible itself': (AT + ', with requireVisible True\n', 2, 'requireVisible has no effect'),
    'deviation without mutate': (AT + ', with positionStdDev (2, 2, 0)\n', 2,
                                 'positionStdDev has no effect here: without "mutate"'),
    'mutator without mutate': (
        MODEL + 'class Left(Mutator):\n    def appliedTo(self, obj):\n        return obj, False\n'
        'ego = new Plane at (0, 400), with mutator (Left(),)\n', 5, 'mutator has no effect here'),
    'property that nothing reads': (
        MODEL + 'class Own(Plane):\n    fuel: 9\nego = new Own at (0, 400), with fuel 5\n', 4,
        'fuel has no effect here: nothing reads it'),
    'typo of a point': (AT + '\nnew Point at (3, 4), with widht 3\n', 3, 'with widht: no property'),
    'view of a point': (AT + '\nnew OrientedPoint at (3, 4), with viewAngle 9\n', 3,
                        'viewAngle has no effect here'),
    'view beside a requirement': (
        PLANE[:-1] + ', with viewAngle 1\nrequire ego.position.x > 0\n', 2, 'viewAngle has no'),
    'direction of nothing': (AT + ', with onDirection (0, 0, 1)\n', 2, 'onDirection has no'),
    'sensors assigned': (AT + '\nego.sensors["a"] = 1\n', 2, 'sensors has no effect here'),
    'mutate in a module': (AT + '\nimport moving\n', 1, 'mutate has no effect here: there is'),
    'mutate by nothing': (AT + '\nmutate ego by 0\n', 3, 'mutate has no effect here'),
    'require never': (PLANE + 'require[0] ego.position.x > 0\n', 3, 'require[0] has no effect'),
    'edges of buckets': (
        MODEL + 'ego = new Plane at (0, VerifaiParameter.withPrior(Range(0, 9), buckets=[0, 3]))\n',
        2, 'ValueError: buckets is [0, 3]; it has to be a whole number above 0'),
}
"""Program, line and beginning of what is said."""

LIBRARY = """behavior Drive():
    wait


monitor Watch():
    wait


SPEED = 3


def cone():
    # beside the runway
    new Object at (20, 400)

def keep():
    record ego.position

scenario Main():
    compose:
        wait
"""
OTHERS = {
    'library': LIBRARY, 'library2': 'param fog = 3\n', 'library3': 'param duration = 9\n',
    'library4': 'import random\nX = random.random()\n',
    'moving': 'mutate\n', 'ending': 'terminate when 1 > 0\n',
    'watching': 'monitor Watch():\n    wait\nrequire monitor Watch()\n',
    'planes': MODEL + 'class Late(Plane):\n    position: (0, 700)\n',
}


@pytest.mark.one_in(4)
@pytest.mark.parametrize('case', REFUSED)
def test_s5_what_has_no_effect_is_refused_by_name_and_line(
    case: str, ask: Ask, tmp_path: Path
) -> None:
    text, line, message = REFUSED[case]
    error = ask(text, **OTHERS)['error']
    print(error)
    assert error['message'].startswith(message)
    assert error['line'] == line
    assert Path(error['file']).parent == tmp_path
    assert '\n' not in error['message']


@pytest.mark.parametrize(('value', 'imported'), [
    ('date.today().day', 'from datetime import date'),
    ('t.time() // 3600', 'import time as t'), ('os.getpid() % 1000', 'import os'),
    ('randbelow(2)', 'from secrets import randbelow'), ('clocked.X', 'import clocked'),
    *(pytest.param(*case, marks=pytest.mark.nightly) for case in [
        ('datetime.datetime.now().day', 'import datetime'),
        ('datetime.utcnow().toordinal() % 99', 'from datetime import datetime'),
        ('time() // 3600', 'from time import time'),
        ('time_ns() // 10**15', 'from time import time_ns'),
        ('localtime().tm_yday', 'from time import localtime'),
        ('int(strftime("%j"))', 'from time import strftime'),
        ('secrets.choice([3, 4])', 'import secrets'), ('os.urandom(1)[0]', 'import os'),
        ('uuid.uuid4().int % 2', 'import uuid'), ('np.random.default_rng().integers(2)', NP),
        ('chance.X', 'import chance'), ('numpys.X', 'import numpys'),
    ]),
])
def test_s5_what_answers_otherwise_another_day_or_elsewhere_is_refused(
    value: str, imported: str, ask: Ask, tmp_path: Path
) -> None:
    (tmp_path / 'clocked.py').write_text('from datetime import date as d\nX = d.today().day\n')
    (tmp_path / 'chance.py').write_text('import random\nX = random.uniform(0, 9)\n')
    (tmp_path / 'numpys.py').write_text('import numpy.random\nX = numpy.random.uniform(0, 9)\n')
    error = ask(spot(value, imported))['error']
    assert (error['line'], error['message'][:len(TWICE)]) == (3, TWICE)


WORKS = {
    'plain': (PLANE, {'distance': 400}),
    'place as a vector': (MODEL + 'ego = new Plane at 3 @ 400, facing 9 deg\n',
                          {'cross_track': -3, 'distance': 400, 'heading': 9}),
    'place as a property': (MODEL + 'ego = new Plane with position (3, 400), with yaw 9 deg\n',
                            {'cross_track': -3, 'distance': 400, 'heading': 9}),
    'level': (MODEL + 'ego = new Plane at (0, 400, 0), facing (9 deg, 0, 0)\n',
              {'heading': 9}),
    'neutral words': (AT + ', with speed 0, with velocity (0, 0, 0), with pitch 0,'
                      ' with behavior None,'
                      ' with color None\n', {'distance': 400}),
    'words that are kept': (
        AT + ', with name "c", with allowCollisions True, with occluding True\n',
        {'distance': 400}),
    'collisions of two': (
        AT + ', with allowCollisions False\nnew Cone at (0, 450), with allowCollisions False\n',
        {}),
    'size that the program reads': (
        AT + ', with width 3\nnew Cone at (ego.width, 450)\n', {'distance': 400}),
    'size read by its name': (AT + ', with width 3\nx = getattr(ego, "width")\n', {}),
    'size that a requirement may read': (AT + ', with length 3\nrequire ego in everywhere\n', {}),
    'deviation of a mutation': (AT + ', with positionStdDev (2, 2, 0)\nmutate ego\n', {}),
    'parent orientation': (AT + ', with parentOrientation 9 deg, with yaw 1 deg\n',
                           {'heading': 10}),
    'left of with a width': (MODEL + 'spot = new OrientedPoint at (0, 300)\n'
                             'ego = new Plane left of spot by 1, with width 4\n',
                             {'cross_track': 3}),
    'in a region': (MODEL + 'ego = new Plane in RectangularRegion((0, 500), 0, 1e-9, 1e-9)\n',
                    {'distance': 500}),
    'on a region': (MODEL + 'ego = new Plane on RectangularRegion((0, 500), 0, 1e-9, 1e-9)\n',
                    {'distance': 500}),
    'contained in': (MODEL + 'ego = new Plane contained in RectangularRegion((0, 500), 0, 8, 8),'
                     ' with width 2, with length 3\n', {}),
    'region contained in': (
        MODEL + 'ego = new Plane at (Range(-9, 9), 400),\n'
        '    with regionContainedIn RectangularRegion((0, 400), 0, 2, 2)\n', {}),
    'visible': (
        MODEL + 'eye = new OrientedPoint at (0, 400), with visibleDistance 20\n'
        'ego = new Plane at (Range(-9, 9), 400), with viewAngle 60 deg\n'
        'require eye can see ego\n', {}),
    'mutation scale of a random place': (
        MODEL + 'ego = new Plane at (Range(-1, 1), 400), with mutationScale Range(1, 2)\n', {}),
    'behavior and monitor that nothing uses': (
        PLANE + 'behavior Drive():\n    wait\nmonitor Watch():\n    wait\n', {}),
    'param twice': (PLANE + 'param rain = 0\nparam clouds = "overcast", rain = 5\n', {'rain': 5}),
    'class': (MODEL + 'class Late(Plane):\n    delay: 3\n    position: (0, 400 + self.delay)\n'
              'ego = new Late with delay 5\n', {'distance': 405}),
    'class with words that are kept': (
        MODEL + 'class Own(Plane):\n    allowCollisions: True\n    speed: 0\n'
        'ego = new Own at (0, 400)\n', {}),
    'class of a library': (MODEL + 'from planes import Late\nego = new Late\n',
                           {'distance': 700}),
    'unused library': (MODEL + 'from library import SPEED\n'
                       'ego = new Plane at (SPEED, 400)\n', {'cross_track': -3}),
    'own model': (
        'class Jet:\n    cross_track: 0 - self.position.x\n    distance: self.position.y\n'
        '    heading_deg: self.heading * 57.29577951308232\n'
        'ego = new Jet at (3, 400), facing Range(-3, 3) deg\n', {'cross_track': -3}),
    'keys with their units': (
        MODEL + 'param time_of_day_h = 9, clouds = "stratus", rain_percent = 30, duration_s = 5\n'
        'ego = new Plane at (3, 400)\nrequire ego.cross_track_m < 0 and ego.distance_m == 400\n',
        {'cross_track_m': -3, 'distance_m': 400, 'heading_deg': 0, 'time_of_day_h': 9,
         'rain_percent': 30, 'duration_s': 5}),
    'requirements': (PLANE + 'require ego.cross_track > 0\nrequire[0.5] ego.position.x < 9\n'
                     'require ego.position.x < 1 implies ego.distance > 3\n', {}),
    'initial scenario': (PLANE + 'require ego.distance > 3 if initial scenario else True\n', {}),
    'options and resample': (
        MODEL + 'x = Range(0, 1)\ny = resample(x)\n'
        'param duration = Options({3: 1, 3.0: 2})\nego = new Plane at (x - y, 400)\n',
        {'duration': 3}),
    'param of a library anew': (MODEL + 'import library3\nparam duration = 5\n'
                                'ego = new Plane at (0, 400)\n', {'duration': 5}),
    'param read': (MODEL + 'param duration = 5\n'
                   'ego = new Plane at (0, 400 + globalParameters.duration)\n',
                   {'distance': 405}),
    'scenario block': (
        MODEL + 'scenario Main():\n    setup:\n        param duration = 5\n'
        '        ego = new Plane at (0, 400)\n        require ego.distance > 3\n',
        {'distance': 400, 'duration': 5}),
    'one scenario of several': (
        MODEL + 'scenario Other():\n    setup:\n        ego = new Plane at (0, 9)\n'
        'scenario Main():\n    setup:\n        ego = new Plane at (0, 400)\n',
        {'distance': 400}),
    'workspace that holds it': (
        'model runway_world\nworkspace = Workspace(RectangularRegion((0, 400), 0, 4, 4))\n'
        'ego = new Plane at (Range(-9, 9), 400), with width 2\n', {}),
    'workspace as a region': (
        'model runway_world\nworkspace = Workspace(RectangularRegion((0, 400), 0, 4, 4))\n'
        'ego = new Plane in workspace\n', {}),
    'unused class and point': (PLANE + 'class Cone:\n    height: 1\nnew Point at (0, 3)\n', {}),
    'python': ('import math\nfrom scenic.core.distributions import distributionFunction\n'
               '@distributionFunction\ndef half(x):\n    return x / 2\n' + MODEL
               + 'ego = new Plane at (half(Range(4, 4)), 400 * math.cos(0))\n',
               {'cross_track': -2}),
    'verifai words': (
        MODEL + 'from dotmap import DotMap\nparam verifaiSamplerType = "ce"\n'
        'param verifaiSamplerParams = DotMap(alpha=0.9)\n'
        'ego = new Plane at (VerifaiRange(-1, 1), VerifaiOptions([400, 400]))\n',
        {'distance': 400}),
    'chance with a seed': (
        MODEL + 'import random\nrandom.seed(3)\n'
        'ego = new Plane at (0, random.choice([3, 400]))\n', {}),
    'chance with a seed of its own': (
        MODEL + 'import random\nimport numpy as np\nimport logging\nlogging.warning("now")\n'
        'y = random.Random(3).uniform(0, 9) + np.random.default_rng(3).uniform(0, 9)\n'
        'ego = new Plane at (0, y)\n', {}),
    'chance for each scene': (
        'import random\nfrom scenic.core.distributions import distributionFunction\n'
        '@distributionFunction\ndef noise(x):\n    return x + random.random()\n' + MODEL
        + 'ego = new Plane at (noise(Range(1, 2)), 400)\n', {}),
    'mesh': (MODEL + 'box = MeshVolumeRegion(BoxShape().mesh, position=(0, 400, 0), '
             'dimensions=(9, 9, 9))\nego = new Plane at (0, 400)\nrequire ego.position in box\n',
             {}),
    'text and tools': (PLANE + '"""What it is for."""\nverbosePrint("hello")\n'
                       'assert localPath("x")\n', {}),
}
"""Program, and some values of each of its scenes."""


@pytest.mark.one_in(4)
@pytest.mark.parametrize('case', WORKS)
def test_s5_what_has_an_effect_is_not_refused(case: str, ask: Ask) -> None:
    text, expected = WORKS[case]
    said = ask(text, scenes=2, **OTHERS)
    print(said)
    assert len(said['scenes']) == 2
    for values in said['scenes']:
        assert {key: values[key] for key in by_key(expected)} == pytest.approx(
            by_key(expected), abs=1e-3
        )


def test_s5_a_workspace_holds_the_plane(ask: Ask) -> None:
    said = ask(*WORKS['workspace that holds it'][:1], scenes=60)
    places = [values['cross_track_m'] for values in said['scenes']]
    assert len(places) == 60
    assert max(abs(place) for place in places) <= 1.0, 'a plane of 2 m within 4 m'


def test_s2_mutate_moves_the_scene(ask: Ask) -> None:
    scenes = ask(AT + ', facing 3 deg\nmutate ego by 2\n', scenes=400)['scenes']
    assert len(scenes) == 400
    for key, mean, deviation in (
        ('cross_track_m', -1, 2), ('distance_m', 400, 2), ('heading_deg', 3, 10),
    ):
        values = np.array([values[key] for values in scenes])
        assert np.mean(values) == pytest.approx(mean, abs=5 * deviation / 20), key
        assert np.std(values) == pytest.approx(deviation, rel=5 / np.sqrt(2 * 400)), key


def test_s2_requirements_see_the_plane_where_mutation_put_it(ask: Ask) -> None:
    scenes = ask(AT + '\nmutate ego by 2\nrequire ego.cross_track > 1\n', scenes=40)['scenes']
    assert len(scenes) == 40
    assert all(values['cross_track_m'] > 1 for values in scenes)


def test_s2_a_mutator_of_the_program_moves_the_scene(ask: Ask) -> None:
    text = MODEL + (
        'class Left(Mutator):\n    def appliedTo(self, obj):\n'
        '        obj.position += Vector(-2, 5, 0)\n        return obj, False\n'
        'ego = new Plane at (0, 400), with mutator (Left(),)\nmutate\n'
    )
    (values,) = ask(text)['scenes']
    assert (values['cross_track_m'], values['distance_m']) == (2, 405)
