"""The contract kit: everything that is shipped passes it, and what breaks a contract does not."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from plugins import lay_down

from taxinet_ros import registry, testing
from taxinet_ros.testing import (
    ContractError,
    check_controller,
    check_perception,
    check_requirement,
    check_sampler,
    check_world,
)

LEARNERS = {'bo': {'startup': 5}, 'tpe': {'startup': 5}, 'ce': {'every': 10}}


def named(names: Iterable[str], *fast: str) -> list[Any]:
    """All names; the contracts of those that are not named are checked at night."""
    return [
        name if name in fast else pytest.param(name, marks=pytest.mark.nightly) for name in names
    ]


@pytest.mark.parametrize('name', named(registry.names(registry.PERCEPTIONS), 'truth', 'taxinet'))
def test_given_a_shipped_perception_when_checked_then_it_passes(name: str) -> None:
    check_perception(name)


@pytest.mark.parametrize('name', registry.names(registry.CONTROLLERS))
def test_given_a_shipped_controller_when_checked_then_it_passes(name: str) -> None:
    check_controller(name)


@pytest.mark.parametrize('name', named(registry.names(registry.SAMPLERS), 'halton', 'ce'))
def test_given_a_shipped_sampler_when_checked_then_it_passes(name: str) -> None:
    check_sampler(name, 12 if name == 'bo' else 24, **LEARNERS.get(name, {}))


# Others' simulators have tests of their own, and do not run the same way twice.
@pytest.mark.parametrize('name', [registry.KMWH])
def test_given_a_shipped_world_when_checked_then_it_passes(name: str) -> None:
    check_world(name)


@pytest.mark.parametrize('name', registry.names(registry.REQUIREMENTS))
def test_given_a_shipped_requirement_when_checked_then_it_passes(name: str) -> None:
    check_requirement(name)


CHANCE = 'import random; return random.random() / 10, 1.0'
PERCEPTIONS = {
    'degrees': ('return 0.1, 20.0', 'in metres and radians'),
    'centimetres': ('return 250.0, 0.1', 'in metres and radians'),
    'chance': (CHANCE, r'forgets: .*got: frame 0: \(.*\), then'),
    'hash order': ('return hash("a") / 2**60, 0.0', 'forgets: .*got: in another process frame 0:'),
    'three numbers': ('return 0, 0, 0', 'covariance: got .*expected 2 x 2 or 4 numbers'),
    'failure': ('return 1 / 0', 'ZeroDivisionError'),
    'texts': ('return "0.1", "0.2"', 'expected a pair'),
    'one text': ('return "12"', 'expected a pair'),
    'counts': (
        'global COUNT; COUNT = globals().get("COUNT", 0) + 1; return COUNT / 100, 0.0',
        r'forgets: .*got: frame 0: \(0.01, 0.0\), then \(0.12, 0.0\)',
    ),
}


@pytest.mark.parametrize('case', named(PERCEPTIONS, 'degrees', 'hash order', 'failure'))
def test_given_a_wrong_perception_when_checked_then_it_is_told_how(
    case: str, tmp_path: Path
) -> None:
    body, said = PERCEPTIONS[case]
    (tmp_path / 'mine.py').write_text(f'def look(image):\n    {body}\n')
    with pytest.raises(ContractError, match=f'perception .*mine.py:look: .*{said}'):
        check_perception(f'{tmp_path}/mine.py:look')


SAYS_THAT_IT_CANNOT_TELL = {
    'None': 'return None',
    'not valid': 'return TrackingError(cte_m=float("nan"), he_rad=0.0, valid=False)',
    'at times': 'return (0.1, 0.2) if image.mean() > 100 else None',
    'numbers of numpy': 'import numpy; return numpy.float32([0.1, 0.2])',
}


@pytest.mark.parametrize('case', named(SAYS_THAT_IT_CANNOT_TELL, 'None'))
def test_given_a_perception_that_says_so_where_it_cannot_tell_when_checked_then_it_passes(
    case: str, tmp_path: Path
) -> None:
    head = 'from taxinet_ros.core.types import TrackingError\n\ndef look(image):\n'
    (tmp_path / 'mine.py').write_text(f'{head}    {SAYS_THAT_IT_CANNOT_TELL[case]}\n')
    check_perception(f'{tmp_path}/mine.py:look')


def test_given_a_package_that_remembers_the_first_frame_when_checked_then_it_is_told(
    site: Path,
) -> None:
    code = (
        'FIRST = []\n\ndef look(image):\n    FIRST.append(float(image.mean()))\n'
        '    return FIRST[0] / 100, 0.0\n'
    )
    lay_down(site, 'first-sight', code, perceptions='first = look')
    with pytest.raises(ContractError, match=r'perception first: forgets: .* in another process'):
        check_perception('first')


CONTROLLERS = {
    'degrees': ('return 20.0, 5.0', 'in radians'),
    'backwards': ('return 0.0, -1.0', 'speed not negative'),
    'passes NaN on': ('return -estimate.cte_m, 5.0', 'speed not negative|in radians'),
    'no command': ('return None', 'expected a pair'),
    'texts': ('return "0.1", "5"', 'expected a pair'),
    'signs swapped': (
        'return (0.05 * estimate.cte_m if estimate.usable else 0.0), 5.0',
        r'steering: .*AWAY, by \+0.15 rad where it is left of the centreline',
    ),
    'heading swapped': (
        'return (estimate.he_rad - 0.1 * estimate.cte_m if estimate.usable else 0.0), 5.0',
        r'steering: .*AWAY, by \+0.2 rad where its nose points to the left',
    ),
    'counts': (
        'global COUNT; COUNT = globals().get("COUNT", 0) + 1; return COUNT / 1000, 5.0',
        r'forgets: .*got: frame 0: \(0.001, 5.0\), then \(0.012, 5.0\)',
    ),
    'chance': (CHANCE, r'forgets: .*got: frame 0: \(.*\), then'),
    'dies': ('import os; os._exit(0)', 'lives: .*got: run later: exit code 0'),
}


@pytest.mark.parametrize('case', named(CONTROLLERS, 'degrees', 'passes NaN on', 'signs swapped'))
def test_given_a_wrong_controller_when_checked_then_it_is_told_how(
    case: str, tmp_path: Path
) -> None:
    body, said = CONTROLLERS[case]
    (tmp_path / 'mine.py').write_text(f'def steer(estimate):\n    {body}\n')
    with pytest.raises(ContractError, match=f'controller .*mine.py:steer: .*({said})'):
        check_controller(f'{tmp_path}/mine.py:steer')


def test_given_a_function_that_never_returns_when_checked_then_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'mine.py').write_text('def steer(estimate):\n    while True:\n        pass\n')
    monkeypatch.setattr(testing, '_FUNCTION_S', 2.0)
    with pytest.raises(ContractError, match=r'lives: .*got: run later: no end within 2 s'):
        check_controller(f'{tmp_path}/mine.py:steer')


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


SAMPLERS = {
    'outside': ('return tuple(1.5 for _ in self.space)', 'within'),
    'too_few': ('return ()', 'quantiles for 3 dimensions'),
    'no_seed': ('return self.space.point([0.5 for _ in self.space])', 'give equal points'),
    'no_order': (
        'import random; return self.space.point([random.random() for _ in self.space])',
        'give different points',
    ),
}


def test_given_a_sampler_that_learns_but_says_not_when_checked_then_it_is_told(site: Path) -> None:
    code = """
from taxinet_ros.samplers.registry import MAB, SamplerKind

LEARNS = SamplerKind(meaning='x', make=MAB.make, options=MAB.options, learns=False)
"""
    lay_down(site, 'sampler-learns', code, samplers='learns = LEARNS')
    with pytest.raises(ContractError, match='its points depend on results, but its kind says'):
        check_sampler('learns', 24)


@pytest.mark.parametrize('case', SAMPLERS)
def test_given_a_wrong_sampler_when_checked_then_it_is_told_how(case: str, site: Path) -> None:
    body, said = SAMPLERS[case]
    code = f"""
from taxinet_ros.samplers.registry import SamplerKind

class Wrong:
    def __init__(self, space):
        self.space = space
    def ask(self):
        {body}
    def tell(self, index, rho):
        pass
    def weight(self, index):
        return None
    def drawn(self, index):
        return False
    def learned(self):
        return {{}}

WRONG = SamplerKind(meaning='wrong', make=lambda space, seed, runs, values: Wrong(space))
"""
    lay_down(site, f'sampler-{case}', code, samplers=f'{case} = WRONG')
    with pytest.raises(ContractError, match=f'sampler {case}: .*({said})'):
        check_sampler(case, 8)


WORLDS = {
    'skips': ('self.seq += 2', 'observed step 2, expected 1'),
    'fails': ('1 / 0', 'world .* of world-fails 1.2: .*ZeroDivisionError'),
    'stands': ('pass', 'observed step 0, expected 1'),
}
MADE = {
    'ends_early': ('self.last_seq -= 1', 'last_seq is 9; the scenario ends at step 10'),
    'endless': ('del self.last_seq', 'AttributeError.*last_seq'),
    'sees_nothing': ('self.observe = lambda picture=True: None', 'observed NoneType'),
    'lists': (
        'self.observe = lambda picture=True: dataclasses.replace(self.inner.observe(), image=[1])',
        'the picture is list, no array',
    ),
}


@pytest.mark.parametrize('case', [*WORLDS, *MADE])
def test_given_a_wrong_world_when_checked_then_it_is_told_how(case: str, site: Path) -> None:
    body, said = WORLDS.get(case, ('self.inner.advance(command); self.seq += 1', ''))
    made, said = MADE.get(case, ('pass', said))
    code = f"""
import dataclasses
from taxinet_ros.core.world import SimulatedWorld

class Wrong:
    def __init__(self, scenario, *, pictures=True):
        self.inner, self.seq = SimulatedWorld(scenario, pictures=pictures), 0
        self.last_seq = self.inner.last_seq
        {made}
    def observe(self, *, picture=True):
        seen = self.inner.observe(picture=picture)
        return dataclasses.replace(seen, seq=self.seq, stamp_ns=self.seq * 100_000_000)
    def advance(self, command):
        {body}
"""
    lay_down(site, f'world-{case}', code, worlds=f'{case} = Wrong')
    with pytest.raises(ContractError, match=f'world {case}: .*{said}'):
        check_world(case)


def test_given_requirements_that_cannot_judge_when_checked_then_it_is_told_how(site: Path) -> None:
    lay_down(site, 'our-late', 'LATE = "always[40:60](cte <= 1)"\n', requirements='late = LATE')
    with pytest.raises(ContractError, match='requirement late: '):
        check_requirement('late')
    with pytest.raises(ContractError, match=r'requirement nobody: .*unknown name'):
        check_requirement('nobody')


@pytest.mark.parametrize('check', [
    check_perception, check_controller, check_sampler, check_world, check_requirement,
])
@pytest.mark.parametrize('word', [None, 3])
def test_given_no_name_when_checked_then_that_is_said(
    check: Callable[[Any], None], word: Any
) -> None:
    with pytest.raises(ContractError, match=rf'\w+ {word}: expected its name, got '):
        check(word)


def test_given_the_kit_when_imported_then_pytest_is_not_needed() -> None:
    assert 'taxinet_ros.testing' in sys.modules
    assert 'import pytest' not in Path(sys.modules['taxinet_ros.testing'].__file__).read_text()


RACE = """Traceback (most recent call last):
  File "executors.py", line 673, in _wait_for_ready_callbacks
rclpy._rclpy_pybind11.RCLError: failed to initialize wait set: the given context is not valid, \
either rcl_init() was not called or rcl_shutdown() was called., at wait.c:130
"""
OWN = 'Traceback (most recent call last):\n  File "mine.py", line 1\nKeyError: 3\n'


@pytest.mark.parametrize(('printed', 'shows'), [
    ('goodbye\n', False), (RACE, False), (OWN, True), (RACE + OWN, True),
    (RACE.replace('context is not valid', 'publisher is gone'), True),
])
def test_given_what_a_node_prints_at_its_end_then_only_its_own_tracebacks_count(
    printed: str, shows: bool
) -> None:
    from taxinet_ros.testing.stage import shows_traceback  # imports rclpy

    assert shows_traceback(printed) is shows
