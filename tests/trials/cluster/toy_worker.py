"""A worker without a loop: robustness by the formula of falsify_samples, and a bag of one file.

``toy_worker.py OUT FOLDER --answers=N``; in FOLDER, ``pace`` is the time of a run [s],
``weights`` the fingerprint of its perception, and ``deadly-I`` kills the worker at run I, once.
"""

import json
import math
import os
import signal
import sys
import time
from pathlib import Path

OUT, FOLDER = map(Path, sys.argv[1:3])
ANSWERS = int(sys.argv[3].partition('=')[2])


def said(name: str, otherwise: str) -> str:
    file = FOLDER / name
    return file.read_text() if file.exists() else otherwise


def answer(run: dict) -> dict:
    scenario = run['scenario']
    rho = math.hypot(scenario['cross_track_m'] + 4, scenario['distance_m'] / 500 - 3) - 2
    (OUT / run['run_id']).mkdir()
    (OUT / run['run_id'] / 'bag').write_text(run['run_id'])
    return {
        'outcome': 'PASS' if rho > 0 else 'FAIL', 'last_seq': 10, 'wall_s': 1.0,
        'robustness': {'phi_eventually': [rho, rho]}, 'perception': 'truth',
        'fingerprint': said('weights', ''),
    }


for line in iter(sys.stdin.readline, ''):
    message = json.loads(line)
    if 'run' not in message:
        break
    time.sleep(float(said('pace', '0')))
    deadly = FOLDER / f'deadly-{message["run"]["index"]}'
    if deadly.exists():
        deadly.unlink()
        os.kill(os.getpid(), signal.SIGKILL)
    os.write(ANSWERS, json.dumps({'result': answer(message['run'])}).encode() + b'\n')
