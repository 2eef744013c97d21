"""Closed-loop testing of vision-based aircraft taxiing, on ROS 2 and without it.

The public Python API; ``docs/python.md`` has examples of each name::

    import taxinet_ros as tx

    run = tx.run(tx.Scenario(cross_track_m=4.0), perception='taxinet')
    run.outcome, run.rho['phi_eventually'], run.trace

Importing this package loads no library, but restricts those loaded later to code that rounds alike
on every processor (:mod:`taxinet_ros.instructions`). Each name is imported when it is first used
(PEP 562).
"""

import importlib
from typing import TYPE_CHECKING, Any

from taxinet_ros.instructions import pin

if TYPE_CHECKING:
    from taxinet_ros.api.campaign import (
        Campaign,
        Counterexample,
        compare,
        odd_coverage,
        open_campaign,
        open_recording,
    )
    from taxinet_ros.api.fork import fork
    from taxinet_ros.api.run import Run, load_perception, render, robustness, run
    from taxinet_ros.api.search import estimate, falsify
    from taxinet_ros.bag.errors import BagError
    from taxinet_ros.bag.run.recording import Recording
    from taxinet_ros.core.motion.controller import SteeringGains, SteeringLaw
    from taxinet_ros.core.mtl.specs import Spec
    from taxinet_ros.core.place.catalogue import load_place
    from taxinet_ros.core.rig.catalogue import load_aircraft, load_camera
    from taxinet_ros.core.scenario import Scenario
    from taxinet_ros.core.sensors import load_sensors
    from taxinet_ros.core.traffic.traffic_file import load_traffic
    from taxinet_ros.core.types import AircraftState, TaxiCommand, TrackingError
    from taxinet_ros.core.user_code import UserCodeError
    from taxinet_ros.core.verdict.outcome import Outcome
    from taxinet_ros.errors import InfraError, RecordError, UsageError
    from taxinet_ros.extras.evidence.api import evidence, verify_evidence
    from taxinet_ros.extras.forecast.forecast import load_forecast
    from taxinet_ros.version import __version__ as __version__

__all__ = [
    'AircraftState',
    'BagError',
    'Campaign',
    'Counterexample',
    'InfraError',
    'Outcome',
    'RecordError',
    'Recording',
    'Run',
    'Scenario',
    'Spec',
    'SteeringGains',
    'SteeringLaw',
    'TaxiCommand',
    'TrackingError',
    'UsageError',
    'UserCodeError',
    'compare',
    'estimate',
    'evidence',
    'falsify',
    'fork',
    'load_aircraft',
    'load_camera',
    'load_forecast',
    'load_perception',
    'load_place',
    'load_sensors',
    'load_traffic',
    'odd_coverage',
    'open_campaign',
    'open_recording',
    'render',
    'robustness',
    'run',
    'verify_evidence',
]

_MODULES = {
    'taxinet_ros.api.campaign': (
        'Campaign', 'Counterexample', 'compare', 'odd_coverage', 'open_campaign', 'open_recording',
    ),
    'taxinet_ros.extras.evidence.api': ('evidence', 'verify_evidence'),
    'taxinet_ros.extras.forecast.forecast': ('load_forecast',),
    'taxinet_ros.api.fork': ('fork',),
    'taxinet_ros.api.run': ('Run', 'load_perception', 'render', 'robustness', 'run'),
    'taxinet_ros.api.search': ('estimate', 'falsify'),
    'taxinet_ros.bag.errors': ('BagError',),
    'taxinet_ros.bag.run.recording': ('Recording',),
    'taxinet_ros.core.motion.controller': ('SteeringGains', 'SteeringLaw'),
    'taxinet_ros.core.mtl.specs': ('Spec',),
    'taxinet_ros.core.verdict.outcome': ('Outcome',),
    'taxinet_ros.core.place.catalogue': ('load_place',),
    'taxinet_ros.core.rig.catalogue': ('load_aircraft', 'load_camera'),
    'taxinet_ros.core.scenario': ('Scenario',),
    'taxinet_ros.core.sensors': ('load_sensors',),
    'taxinet_ros.core.traffic.traffic_file': ('load_traffic',),
    'taxinet_ros.core.types': ('AircraftState', 'TaxiCommand', 'TrackingError'),
    'taxinet_ros.core.user_code': ('UserCodeError',),
    'taxinet_ros.errors': ('InfraError', 'RecordError', 'UsageError'),
    'taxinet_ros.version': ('__version__',),
}


pin()


def __getattr__(name: str) -> Any:
    for module, names in _MODULES.items():
        if name in names:
            value = globals()[name] = getattr(importlib.import_module(module), name)
            return value
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith('__'))})
