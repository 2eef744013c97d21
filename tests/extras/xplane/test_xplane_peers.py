"""Clients that others wrote talk to the fake X-Plane, so that it is not only our idea of one.

xpwebapi needs Python 3.12 and other versions of libraries than ours, so it lives in an environment
of its own: TAXINET_XPLANE_PEERS names its interpreter (.ci/run makes one where it can). TAXINET_XPC
names the folder ``Python3/src`` of a copy of NASA's XPlaneConnect.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest
from fake_xplane import FakeXPlane

PYTHON = os.environ.get('TAXINET_XPLANE_PEERS', sys.executable)
XPC = os.environ.get('TAXINET_XPC', '')

pytestmark = pytest.mark.nightly

REST = """
import xpwebapi
api = xpwebapi.rest_api(host='127.0.0.1', port={web_port})
api.set_api_version()
rain = api.dataref('sim/weather/region/rain_percent')
rain.value = 0.5
wrote = api.write_dataref(rain)
cloud = api.dataref('sim/weather/region/cloud_type[1]')
cloud.value = 3.0
wrote_element = api.write_dataref(cloud)
name = api.dataref_value(api.dataref('sim/aircraft/view/acf_ui_name'))
name = name.decode().rstrip(chr(0))
did = api.execute_command(api.command('sim/operation/regen_weather'))
print(json.dumps({{
    'version': api.version, 'x_plane': api.xp_version, 'wrote': [wrote, wrote_element, did],
    'rain': api.dataref_value(api.dataref('sim/weather/region/rain_percent')),
    'clouds': api.dataref_value(api.dataref('sim/weather/region/cloud_type')), 'name': name,
}}))
"""
NASA = """
import xpc
with xpc.XPlaneConnect('127.0.0.1', {connect_port}, timeout=20000) as api:
    api.sendDREF('sim/weather/region/rain_percent', 0.5)
    rain = api.getDREF('sim/weather/region/rain_percent')
    arrays = api.getDREFs(
        ['sim/weather/region/cloud_type', 'sim/weather/region/variability_pct', 'sim/no/such']
    )
    print(json.dumps([rain, arrays, api.getPOSI()]))
"""


def has(module: str, python: str = PYTHON) -> bool:
    return subprocess.run([python, '-c', f'import {module}'], capture_output=True).returncode == 0


def say(sim: FakeXPlane, script: str, python: str = PYTHON, **environment: str) -> Any:
    text = 'import json\n' + script.format(**vars(sim))
    done = subprocess.run(
        [python, '-c', text], capture_output=True, text=True, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.skipif(
    not has('xpwebapi'), reason='xpwebapi, for Python 3.12: TAXINET_XPLANE_PEERS names none'
)
def test_xpwebapi_over_the_web_api(sim):
    told = say(sim, REST)
    assert told == {
        'version': 'v3', 'x_plane': '12.4.0', 'wrote': [True, True, True], 'rain': 0.5,
        'clouds': [0.0, 3.0, 0.0], 'name': 'Cessna 208B Grand Caravan',
    }
    assert sim.commands == ['sim/operation/regen_weather']


@pytest.mark.skipif(not XPC, reason="NASA's client: TAXINET_XPC names no copy")
def test_the_client_of_nasa(sim):
    rain, arrays, position = say(sim, NASA, sys.executable, PYTHONPATH=XPC)
    assert rain == [0.5]
    assert arrays == [[0.0, 0.0, 0.0], [0.0], []]
    there = [sim.values[f'sim/flightmodel/position/{name}'] for name in
             ('latitude', 'longitude', 'elevation', 'theta', 'phi', 'true_psi')]
    assert position[:2] == pytest.approx(there[:2], abs=1e-9)
    assert position[2:] == pytest.approx([*there[2:], 1.0], abs=1e-3)
