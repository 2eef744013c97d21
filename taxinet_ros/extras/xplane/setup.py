"""Where X-Plane is and how it is used: the YAML file that TAXINET_XPLANE names."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.core.datarefs import split_name
from taxinet_ros.extras.xplane import connect, web
from taxinet_ros.extras.xplane.connect import XPlaneConnect
from taxinet_ros.extras.xplane.web import WebApi
from taxinet_ros.files.plain_values import Section, read_yaml

VARIABLE = 'TAXINET_XPLANE'
"""Environment variable with the path of the file; without it, everything has its default."""
WIRES = {'web': web.PORT, 'connect': connect.PORT}
"""Usual port of each interface."""

_KEYS = (
    'wire', 'host', 'port', 'timeout_s', 'aircraft', 'view', 'display', 'region_px', 'settle_s',
    'frames',
)
_MOST_PX = 16384


@dataclass(frozen=True, kw_only=True)
class XPlaneSetup:
    """Where X-Plane is and how it is used.

    Attributes:
        wire: a key of :data:`WIRES`.
        host: its name or address.
        port: of the interface.
        timeout_s: wait for each answer [s]; questions are asked three times.
        aircraft: required part of the name of the loaded aircraft; '' for any.
        view: command that selects a view without cockpit.
        display: X11 display to take pictures from; '' for that of the environment.
        region_px: left, top, width and height of X-Plane's picture there; None for the first
            monitor.
        settle_s: simulated time for which the aircraft is held under new weather [s].
        frames: frames that X-Plane has to draw between a confirmed pose and its picture.
    """

    wire: str = 'web'
    host: str = '127.0.0.1'
    port: int = web.PORT
    timeout_s: float = 5.0
    aircraft: str = ''
    view: str = 'sim/view/forward_with_nothing'
    display: str = ''
    region_px: tuple[int, int, int, int] | None = None
    settle_s: float = 5.0
    frames: int = 3

    def open(self) -> WebApi | XPlaneConnect:
        """Open the interface."""
        if self.wire == 'connect':
            return XPlaneConnect(self.host, self.port, timeout_s=self.timeout_s)
        return WebApi(self.host, self.port, timeout_s=self.timeout_s)


def read_setup(path: Path) -> XPlaneSetup:
    """Read a file."""
    top = Section(path, read_yaml(path, option=VARIABLE), _KEYS)
    wire = top.word('wire', tuple(WIRES), 'web')
    if 'aircraft' in top and wire != 'web':
        raise top.wrong('has no effect: the plug-in tells no names; leave it out', 'aircraft')
    view = top.text('view', XPlaneSetup.view)
    top.check('view', lambda: split_name(view))
    return XPlaneSetup(
        wire=wire, host=top.text('host', XPlaneSetup.host),
        port=top.whole('port', 1, 65535, WIRES[wire]),
        timeout_s=top.number('timeout_s', 0.1, 600, XPlaneSetup.timeout_s),
        aircraft=top.text('aircraft', ''), view=view, display=top.text('display', ''),
        region_px=_region(top),
        settle_s=top.number('settle_s', 0, 600, XPlaneSetup.settle_s),
        frames=top.whole('frames', 1, 100, XPlaneSetup.frames),
    )


def _region(top: Section) -> tuple[int, int, int, int] | None:
    if 'region_px' not in top:
        return None
    left, top_px, width, height = map(int, top.numbers('region_px', 4, 0, _MOST_PX))
    if not (width and height):
        raise top.wrong('expected LEFT, TOP, WIDTH, HEIGHT, the last two above 0', 'region_px')
    return left, top_px, width, height


def chosen_setup() -> XPlaneSetup:
    """The setup of the environment."""
    path = os.environ.get(VARIABLE, '')
    return read_setup(Path(path)) if path else XPlaneSetup()
