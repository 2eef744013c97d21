"""taxinet xplane doctor, and pictures from a real X11 display."""

from __future__ import annotations

import ctypes
import os
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
from taxinet_ros.extras.xplane.commands import xplane_doctor
from taxinet_ros.extras.xplane.doctor import Finding, findings
from taxinet_ros.extras.xplane.camera import Display

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


def test_what_fails_first_ends_what_builds_on_it(sim):
    found = examine(sim, aircraft='Boeing')
    assert found['answer'].fine is False
    assert found['values'].words == found['driving'].words == 'not checked'
    assert sim.values['sim/time/sim_speed'] == 1


def test_a_missing_dataref_is_named(sim):
    del sim.values['sim/weather/region/runway_friction']
    found = examine(sim)['values']
    assert found.fine is False
    assert '1 of' in found.words
    assert 'sim/weather/region/runway_friction' in found.words


def test_a_window_that_shows_something_else(sim):
    sim.frozen_screen = True
    found = examine(sim)['pictures']
    assert found.fine is False
    assert 'without a move' in found.words


def test_late_pictures_are_told(sim):
    plain, shown = sim.frame, []

    def late() -> None:
        plain()
        shown.append(sim.pose())
        sim.shown = shown[max(0, len(shown) - 40)]

    sim.frame = late
    assert '; set frames to' in examine(sim)['pictures'].words


def test_a_nose_wheel_that_does_not_obey(sim):
    plain = sim.set
    sim.set = lambda name, *more: None if 'tire_steer' in name else plain(name, *more)
    found = examine(sim)['driving']
    assert found.fine is False
    assert 'does the nose wheel obey' in found.words


def test_the_command(sim, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv('DISPLAY', raising=False)
    path = tmp_path / 'xplane.yaml'
    path.write_text(f'port: {sim.web_port}\nsettle_s: 0\ntimeout_s: 30\n')
    with pytest.raises(typer.Exit) as ended:
        xplane_doctor(path)
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
        [Path(sys.executable).with_name('taxinet'), 'xplane', 'doctor', '--setup', path],
        capture_output=True, text=True,
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


@needs_x
def test_without_a_region_it_is_the_first_monitor(display):
    screen = Display(display, None)
    assert screen.grab().shape == (480, 640, 3)
    screen.close()


@needs_x
def test_a_region_beyond_the_display(display):
    with pytest.raises(UsageError, match='region_px 400, 0, 320, 200 is not within the 640 x 480'):
        Display(display, (400, 0, 320, 200))


def test_no_display():
    pytest.importorskip('mss')
    with pytest.raises(InfraError, match='not_ready: x-plane: display :987'):
        Display(':987', None)
