"""taxinet xplane doctor, and pictures from a real X11 display."""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import typer
from fake_xplane import FakeScreen, FakeXPlane, setup_of

from taxinet_ros.errors import ExitCode, InfraError, UsageError
from taxinet_ros.extras.xplane.camera import Display
from taxinet_ros.extras.xplane.commands import xplane_doctor
from taxinet_ros.extras.xplane.doctor import Finding, findings

REGION = 'sim/weather/region/'
ALL = ('answer', 'values', 'pause', 'start', 'view', 'pictures', 'driving')


def examine(sim: FakeXPlane, **more: object) -> dict[str, Finding]:
    found = list(findings(setup_of(sim, **more), lambda *_: FakeScreen(sim)))
    assert [one.name for one in found] == list(ALL)
    return {one.name: one for one in found}


@pytest.mark.parametrize('wire', ['web', 'connect'])
def test_all_is_well(sim, wire):
    found = examine(sim, wire=wire)
    assert all(one.fine for one in found.values())
    assert 'X-Plane 12' in found['answer'].words
    assert 'placed 400.00 m along the runway' in found['start'].words
    assert '0.000 m and 0.0' in found['view'].words
    assert 'in 10 steps of 0.1 s' in found['driving'].words
    assert sim.values['sim/time/sim_speed'] == 1
    assert sim.values['sim/operation/override/override_planepath'][0] == 0


def deaf(sim: FakeXPlane) -> None:
    plain = sim.set
    sim.set = lambda name, *more: None if 'tire_steer' in name else plain(name, *more)


@pytest.mark.nightly
@pytest.mark.parametrize(('check', 'spoil', 'words'), [
    ('answer', lambda sim: sim.values.update({'sim/aircraft/view/acf_ui_name': b'Boeing'}),
     "the aircraft is 'Boeing'"),
    ('values', lambda sim: sim.values.pop(REGION + 'runway_friction'),
     f'1 of 20 cannot be written: web API .* {REGION}runway_friction'),
    ('pictures', lambda sim: setattr(sim, 'frozen_screen', True), 'without a move'),
    ('driving', deaf, 'does the nose wheel obey'),
])
def test_what_fails_first_is_named_and_ends_what_builds_on_it(sim, check, spoil, words):
    spoil(sim)
    found = examine(sim, aircraft='208B')
    at = ALL.index(check)
    assert [one.fine for one in found.values()] == [True] * at + [False] + [None] * (6 - at)
    assert re.search(words, found[check].words), found[check].words
    assert all(found[later].words == 'not checked' for later in ALL[at + 1:])
    assert sim.values['sim/time/sim_speed'] == 1


def test_late_pictures_are_told(sim):
    plain, shown = sim.frame, []

    def late() -> None:
        plain()
        shown.append(sim.pose())
        sim.shown = shown[max(0, len(shown) - 40)]

    sim.frame = late
    assert '; set frames to' in examine(sim)['pictures'].words


def test_the_command(sim, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv('DISPLAY', raising=False)
    path = tmp_path / 'xplane.yaml'
    path.write_text(f'port: {sim.web_port}\nsettle_s: 0\ntimeout_s: 30\n')
    monkeypatch.setenv('TAXINET_XPLANE', str(path))
    with pytest.raises(typer.Exit) as ended:
        xplane_doctor()
    assert ended.value.exit_code == ExitCode.INFRA
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f'ok   setup     web at 127.0.0.1:{sim.web_port}, of {path}'
    assert lines[5].startswith(('BAD  view      not_ready: display of the environment',
                                'BAD  view      x-plane: pictures need the package mss'))
    assert lines[6] == '--   pictures  not checked'
    assert len(lines) == 1 + len(ALL)


def test_the_command_without_x_plane(tmp_path):
    path = tmp_path / 'xplane.yaml'
    path.write_text('port: 1\n')
    done = subprocess.run(
        [Path(sys.executable).with_name('taxinet'), 'xplane', 'doctor'],
        capture_output=True, text=True, env={**os.environ, 'TAXINET_XPLANE': str(path)},
    )
    assert done.returncode == ExitCode.INFRA
    assert 'BAD  answer    not_ready: web API at 127.0.0.1:1: nothing listens there' in done.stdout
    assert done.stderr == ''


# A real display

needs_x = pytest.mark.skipif(shutil.which('Xvfb') is None, reason='Xvfb is not installed')


@pytest.fixture
def display() -> Iterator[str]:
    pytest.importorskip('mss')
    reader, writer = os.pipe()
    server = subprocess.Popen(
        ['Xvfb', '-displayfd', str(writer), '-screen', '0', '640x480x24', '-nolisten', 'tcp'],
        pass_fds=[writer], stderr=subprocess.DEVNULL,
    )
    os.close(writer)
    with os.fdopen(reader) as told:
        number = told.readline().strip()
    if not number:
        pytest.skip('Xvfb does not start here')
    yield f':{number}'
    server.terminate()
    server.wait()


class Painter:
    """Colours the background of a display, the way any program does."""

    def __init__(self, display: str) -> None:
        self.x11 = ctypes.CDLL('libX11.so.6')
        self.x11.XOpenDisplay.restype = ctypes.c_void_p
        self.x11.XDefaultRootWindow.restype = ctypes.c_ulong
        self.there = ctypes.c_void_p(self.x11.XOpenDisplay(display.encode()))
        self.root = ctypes.c_ulong(self.x11.XDefaultRootWindow(self.there))

    def paint(self, colour: int) -> None:
        self.x11.XSetWindowBackground(self.there, self.root, ctypes.c_ulong(colour))
        self.x11.XClearWindow(self.there, self.root)
        self.x11.XSync(self.there, 0)

    def close(self) -> None:
        self.x11.XCloseDisplay(self.there)


@needs_x
def test_a_region_of_a_display_is_red_green_blue(display):
    painter, screen = Painter(display), Display(display, (10, 20, 320, 200))
    for colour in (0xFF8000, 0x0040FF):
        painter.paint(colour)
        picture = screen.grab()
        assert picture.shape == (200, 320, 3)
        assert picture.dtype == np.uint8
        wanted = [colour >> 16, colour >> 8 & 255, colour & 255]
        assert (picture == wanted).all()
    screen.close()
    painter.close()
    whole = Display(display, None)  # the first monitor
    assert whole.grab().shape == (480, 640, 3)
    whole.close()
    with pytest.raises(UsageError, match='region_px 400, 0, 320, 200 is not within the 640 x 480'):
        Display(display, (400, 0, 320, 200))


def test_no_display():
    pytest.importorskip('mss')
    with pytest.raises(InfraError, match='not_ready: x-plane: display :987'):
        Display(':987', None)
