"""One seed gives one table in every process, whatever addresses its objects have."""

from __future__ import annotations

import copy
import json
import random
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from typing import Any

import pytest

from taxinet_ros.processes.child import child_environment
from taxinet_ros.scenes.programs import shipped_folder

EGO = 'ego = new Plane at (0, Range(0, 2000))\n'
PROGRAMS = {
    'two vectors': (
        'a = Range(-300, 300) @ 1000\nb = Range(0, 50) @ 1000\nrequire a.x > 200\n'
        'require b.x > 40\n',
        ['a.x', 'b.x'],
    ),
    'three vectors': (
        'a = Range(0, 9) @ 5\nb = Range(0, 99) @ 9\nc = 5 @ Range(0, 999)\n'
        'require a.x > 7 and b.x > 70\nrequire (distance from b to c) < 200\n',
        ['a.x', 'b.x', 'c.y'],
    ),
    'offsets of a common spot': (
        'spot = 0 @ Range(800, 1200)\nhold = spot offset by (0, Range(20, 60))\n'
        'turn = spot offset by Range(-4, -1) @ Range(0, 9)\n'
        'require hold.y - spot.y > 50\nrequire turn.x < -3 and turn.y - spot.y > 6\n',
        ['spot.y', 'hold.y', 'turn.x', 'turn.y'],
    ),
    'tuples': (
        'a = (Range(0, 10), 3)\nb = (Range(0, 20), Range(0, 1000))\nrequire a[0] > 8\n'
        'require b[0] > 15 and b[1] > 700\n',
        ['a[0]', 'b[0]', 'b[1]'],
    ),
    'lists': (
        'gaps = [Range(0, 9), Normal(500, 9)]\n'
        'spots = [Range(-9, 9) @ (300 * k) for k in range(2)]\nfar = 2 * gaps[0]\n'
        'require all(abs(spot.x) > 5 for spot in spots)\nrequire gaps[1] > 505 and far > 9\n',
        ['far', 'spots[0].x', 'spots[1].x', 'gaps[1]'],
    ),
    'closures': (
        'def make(low):\n    gap = Range(low, 900)\n    far = Range(low, 2000) @ 3\n'
        '    def near():\n        return gap > 600 and far.x > 900\n    return near\n'
        'first = make(10)\nsecond = make(200)\nrequire first()\nrequire second()\n',
        ['far.x', 'gap', 'far.x.2', 'gap.2'],
    ),
    'locals of a function': (
        'def keep(y):\n    spot = Range(-50, 50) @ y\n    gap = Range(5, 60)\n'
        '    require spot.x > gap\nfor y in (200, 600):\n    keep(y)\n',
        ['gap', 'spot.x', 'gap.2', 'spot.x.2'],
    ),
    'nested options': (
        'a = Options({Uniform(Range(0, 9), Range(500, 900)): 2, Range(100, 200): 1}) @ 3\n'
        'b = Uniform(3 @ 4, Range(5, 8) @ 7)\nrequire a.x > 600\nrequire b.x > 6\n',
        ['b', 'b[1].x', 'a.x', 'a.x[0]', 'a.x[1]'],
    ),
    'regions': (
        'a = CircularRegion((Range(-9, 9), 900), Range(50, 500))\n'
        'b = RectangularRegion((0, Range(0, 500)), 0, 99, Range(900, 1500))\n'
        'require ego.position in a and ego.position in b\n',
        ['a[0]', 'a', 'b.y', 'b'],
    ),
}
"""Programs after ``model runway_world`` and an ego, and what they call their other choices."""

ORDERS = 3
"""Times that each program is compiled; a set of two has one order in all of them in 1 of 4."""


@pytest.fixture(scope='module')
def tables() -> dict[str, list[Any]]:
    """By program: names and scenes of each time, from a process like that of all scenes."""
    done = subprocess.run([sys.executable, __file__], env=child_environment(), capture_output=True,
                          text=True, check=True)
    found: dict[str, list[Any]] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.parametrize('name', PROGRAMS)
def test_choices_that_only_requirements_read_give_one_table_a_seed_and_have_names(
    tables: dict[str, list[Any]], name: str,
) -> None:
    first, *others = tables[name]
    assert len(others) == ORDERS - 1
    assert first['names'] == ['ego.position.y', *PROGRAMS[name][1]]
    assert len({str(scene['values']) for scene in first['drawn']}) == 3
    assert others == [first] * (ORDERS - 1)


def test_sets_of_a_programs_own_random_values_have_the_order_in_which_they_were_filled(
    tables: dict[str, list[Any]],
) -> None:
    numbers = tables['hashes']
    assert len(numbers) == 60
    assert numbers == sorted(set(numbers))


def main() -> None:
    """Print the names and scenes of each program, hashed anew each time as by new addresses."""
    from scenic.core.distributions import Distribution, Range, Samplable
    from scenic.core.object_types import Point

    from taxinet_ros.scenes.scenic_child import Programs

    programs = Programs(1, str(shipped_folder()))
    ranges = [Range(0, 1) for _ in range(20)]
    some = [*ranges, *map(copy.copy, ranges), *(Point._with() for _ in range(20))]
    random.Random(1).shuffle(some)
    found: dict[str, list[Any]] = {'hashes': [hash(one) for one in some]}
    with tempfile.TemporaryDirectory() as scratch, warnings.catch_warnings():
        warnings.simplefilter('ignore')
        path = Path(scratch) / 'mine.scenic'
        for name, (text, _) in PROGRAMS.items():
            path.write_text('model runway_world\n' + EGO + text)
            for salt in range(ORDERS):
                for kind in (Samplable, Distribution):
                    kind.__hash__ = lambda self, salt=salt: hash((salt, id(self)))
                programs.compile(str(path))
                choices = programs.space()['choices']
                found.setdefault(name, []).append({
                    'names': [choice['dimension']['name'] for choice in choices],
                    'drawn': [programs.scene(index) for index in range(3)],
                })
    json.dump(found, sys.stdout)


if __name__ == '__main__':
    main()
