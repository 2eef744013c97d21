"""ARCH-COMP's systems against known answers; searches of its formulas."""

from __future__ import annotations

import json
import math

import arch
import numpy as np
import pytest
from arch_models import _slopes, automatic_transmission, chasing_cars

FULL = (1 - 1e-16, 0.0)
IDLE = (0.0, 0.0)


def point(name: str, *inputs: float) -> tuple[float, ...]:
    return inputs * arch.FORMULAS[name][0].segments


def constant(segments: int, *inputs: float) -> np.ndarray:
    return np.tile(inputs, (1, segments, 1))


def test_given_full_throttle_then_the_transmission_is_that_of_simulink() -> None:
    stamps_ns, signals = automatic_transmission(constant(7, 100.0, 0.0))
    # Simulink's figures: github.com/mshaheryarmalik/stgem, problems/arch-comp-2021/at/README.md.
    assert stamps_ns[2000] == 20 * 10**9
    assert signals['speed'][0, 2000] == pytest.approx(120.21327149261522, rel=1e-13)
    assert signals['rpm'].max() == pytest.approx(4768.277187862124, rel=1e-13)
    shifts = np.flatnonzero(np.diff(signals['gear'][0]))
    assert len(shifts) == 3
    assert (stamps_ns[shifts + 1] % 40_000_000 == 0).all(), 'the shift logic runs every 0.04 s'


def test_given_the_car_at_rest_then_its_slopes_are_those_by_hand() -> None:
    torques = np.array([[267.0, 301.0]])
    line = (3 * torques[:, :1] - 2 * torques[:, 1:], np.diff(torques) / 400)  # of 800, 1200 rpm
    engine, wheels = _slopes(
        np.array([1000.0]), np.zeros(1), np.array([2.393]), line, np.zeros(1))
    impeller = (1000 / 137.4652089938063) ** 2  # the converter stalls
    assert engine == pytest.approx((284 - impeller) / 0.0219914882835559)  # half of 267 and 301
    assert wheels == pytest.approx(3.23 * 2.393 * 2.232 * impeller / 12.09414785731247)


def test_given_constant_throttle_then_the_first_two_cars_are_as_by_hand() -> None:
    stamps_ns, signals = chasing_cars(constant(20, 1.0, 0.0))
    since_s = stamps_ns / 1e9
    np.testing.assert_allclose(signals['y1'][0], -since_s**2 / 2, atol=1e-9)
    # The second keeps at 10 until the first is at -5, and then accelerates as that one.
    starts_s = math.sqrt(10)
    chased = np.maximum(since_s - starts_s, 0)
    np.testing.assert_allclose(signals['y2'][0], 10 - chased**2 / 2, atol=0.01)
    assert signals['y2'][0, -1] - signals['y1'][0, -1] == pytest.approx(5 + 100 * starts_s, 1e-4)


@pytest.mark.parametrize('brake', [1.0, 1.01e-4, 0.99e-4, 0.0])
def test_given_any_brake_then_the_first_car_solves_its_equation(brake) -> None:
    stamps_ns, signals = chasing_cars(constant(20, 0.5, brake))
    since_s = stamps_ns / 1e9
    exact = -since_s**2 / 4 if not brake else \
        0.5 * (-np.expm1(-brake * since_s) / brake - since_s) / brake
    np.testing.assert_allclose(signals['y1'][0], exact, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(('inputs', 'expected'), [
    (FULL, {'AT1': 120 - 120.21327149261522, 'AT2': 4750 - 4768.277187862124}),
    (IDLE, {'CC1': 40 - 10, 'CC2': 10 - 15, 'CC4': 10 - 8, 'CCx': 10 - 7.5}),
])
def test_given_a_known_simulation_then_formulas_have_its_robustness(inputs, expected) -> None:
    found = arch.rhos(list(expected), [point(name, *inputs) for name in expected])
    assert found == pytest.approx(list(expected.values()), rel=1e-9)


@pytest.mark.nightly
def test_given_words_then_each_search_has_a_line_that_a_single_search_confirms(capsys) -> None:
    words = ['AT2', 'halton', 'corners', '--repeats', '3', '--runs', '9']
    assert arch.main([*words, '--json']) == 0
    lines = json.loads(capsys.readouterr().out)['searches']
    assert [(one['formula'], one['search']) for one in lines] == [
        ('AT2', 'halton'), ('AT2', 'corners')]
    for one in lines:
        low, high = one['rate']
        assert low <= one['falsified'] / 3 <= high
    found = lines[1]['found']
    assert any(found)
    search = arch.Corners(arch.AT.size, 1)
    rhos = arch.rhos(['AT2'] * 9, [search.next()[1] for _ in range(9)])
    assert found[1] == next((run + 1 for run, each in enumerate(rhos) if each < 0), None)
