"""The Scenic child by itself: what it says of each way in which a program can be wrong."""

from __future__ import annotations

from typing import Any

import pytest
from waiting import PATIENT_S

PLANE = 'model runway_world\nego = new Plane at (Range(-1, 1), 400)\n'
LAZY = 'from scenic.core.distributions import distributionFunction\n@distributionFunction\n'


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'line', 'message'), [
    ('model runway_world\nego = new Plane at (0,\nparam x = 1\n', 3, 'invalid syntax'),
    ('model runway_world\n\nego = new Plane at (Rnge(0, 1), 3)\n', 3,
     "NameError: name 'Rnge' is not defined"),
    ('import sys\nmodel runway_world\nsys.exit(3)\n', 3, 'the program calls exit()'),
    ('model runway_world\nego = new Plane at "here"\n', 2, 'TypeError: specifier "at X"'),
    ('model runway_world\nx = Range(0, 1)\nif x > 0.5:\n    pass\n', 3, 'random values cannot'),
    (PLANE + 'hog = bytearray(8 << 30)\n', 3, 'the program needs more memory'),
    (PLANE + 'name = input()\n', 3, 'EOFError'),
    (PLANE + 'param rain = (1, 2)\n', 3, 'rain is a tuple'),
    ('model nowhere\n', 1, 'could not import world model nowhere'),
])
def test_given_a_program_that_does_not_compile_when_compiled_then_its_line_is_named(
    refused: Any, text: str, line: int, message: str,
) -> None:
    refused(text, line, message)


def test_given_a_loop_without_end_when_compiled_then_its_line_is_named(refused: Any) -> None:
    # It shortens its own limit once it is there, for how long it takes to get there varies.
    short = 'import signal\nsignal.setitimer(signal.ITIMER_REAL, 0.2)\n'
    refused(f'{PLANE}{short}while True:\n    pass\n', 5, f'still running after {PATIENT_S:g} s')


@pytest.mark.parametrize(('text', 'line', 'message'), [
    ('x = 1\n', 0, 'no plane to start from'),
    ('ego = new Object at (1, 2)\n', 0, 'no plane to start from'),
    (LAZY + 'def f(x):\n    return 1 / 0\n' + PLANE + 'param rain = f(Range(0, 1))\n', 4,
     'ZeroDivisionError'),
])
def test_given_a_program_that_cannot_be_drawn_when_drawn_then_it_is_told_why(
    client: Any, write: Any, text: str, line: int, message: str,
) -> None:
    path = write(text)
    assert client.ask(op='compile', program=str(path))['named'] == []
    error = client.ask(op='scene', index=0)['error']
    assert (error['file'], error['line']) == (str(path), line)
    assert error['message'].startswith(message)


def test_given_a_program_that_uses_networkx_when_drawn_then_it_is_the_whole_of_it(
    client: Any, compiled: Any,
) -> None:
    compiled(
        'import networkx, trimesh\nfrom networkx import Graph\n'
        'nodes = len(trimesh.creation.box().vertex_adjacency_graph)\n'
        'model runway_world\nego = new Plane at (0, 400)\n'
        'param duration = nodes + len(networkx.path_graph(3)) + len(Graph())\n'
    )
    assert client.ask(op='scene', index=0)['values']['duration_s'] == 11.0


def test_given_a_program_that_uses_what_scenic_imports_later_when_drawn_then_it_is_the_whole_of_it(
    client: Any, compiled: Any,
) -> None:
    compiled(
        'import numpy, trimesh\n'
        'box = trimesh.creation.box()\n'
        'high = round(trimesh.bounds.minimum_cylinder(box)["height"])\n'
        'filled = int(box.voxelized(0.25).fill().filled_count > 0)\n'
        'import scipy.stats, scipy.optimize._root, numpy.f2py\n'
        'root = scipy.optimize.brentq(lambda x: x - 3, 0, 5)\n'
        'even = scipy.stats.norm.cdf(0) * 2 + len(scipy.ndimage.label([1, 0, 1])) '
        '+ len(numpy.f2py.__name__)\n'
        'model runway_world\nego = new Plane at (0, 400)\n'
        'param duration = high + filled + root + even\n'
    )
    assert client.ask(op='scene', index=0)['values']['duration_s'] == pytest.approx(18)


def test_given_values_of_every_kind_when_drawn_then_they_come_out_plain(
    client: Any, compiled: Any,
) -> None:
    assert compiled(
        'import numpy\nmodel runway_world\nprint("noise")\n'
        'ego = new Plane at (0, 400), facing -10 deg\n'
        'param rain = numpy.float32(0.5)\nparam shadows = False\nparam clouds = "clear"\n'
        'param duration = 5\nparam verifaiSamplerType = "halton"\n'
    )['named'] == []
    values = client.ask(op='scene', index=0)['values']
    assert values.pop('heading_deg') == pytest.approx(-10)
    assert values == {'cross_track_m': 0.0, 'distance_m': 400.0, 'rain_percent': 0.5,
                      'shadows': False, 'clouds': 'clear', 'duration_s': 5.0}
    assert str(values['cross_track_m']) == '0.0', 'and not -0.0'
