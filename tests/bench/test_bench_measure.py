from __future__ import annotations

import pytest

from taxinet_ros.bench.measure import Subject, measure


class Clock:
    """Stands still until it is told to go on."""

    def __init__(self) -> None:
        self.now_ns = 0

    def __call__(self) -> int:
        return self.now_ns


def taking(clock: Clock, name: str, times_ns: list[int], **rest: object) -> Subject:
    """A subject whose runs take the times given, one after the other."""
    left = iter(times_ns)

    def run() -> None:
        clock.now_ns += next(left)

    return Subject(name=name, run=run, warm_ups=0, **rest)


def test_given_known_times_when_measured_then_the_statistics_are_theirs() -> None:
    clock = Clock()
    subject = taking(clock, 'a', [10, 50, 20, 40, 30], simulated_s=6e-8)
    figure = measure([subject], 5, wall=clock, cpu=lambda: clock.now_ns // 2)['a']

    assert [figure.min_s, figure.q1_s, figure.median_s, figure.q3_s] == pytest.approx(
        [1e-8, 2e-8, 3e-8, 4e-8]
    )
    assert [figure.cpu_q1_s, figure.cpu_s, figure.cpu_q3_s] == pytest.approx([1e-8, 1.5e-8, 2e-8])
    assert figure.repeats == 5
    assert figure.real_time_factor == pytest.approx(2.0)
    assert figure.real_time_per_core == pytest.approx(4.0)


def test_given_several_calls_in_a_run_when_measured_then_the_figure_is_of_one() -> None:
    clock = Clock()
    figure = measure([taking(clock, 'a', [80], calls=4)], 1, wall=clock, cpu=clock)['a']
    assert (figure.median_s, figure.cpu_s) == pytest.approx((2e-8, 2e-8))
    assert figure.real_time_factor is None
    assert figure.real_time_per_core is None


def test_given_subjects_when_measured_then_they_take_turns_and_the_costly_one_stops_early() -> None:
    log: list[str] = []
    subjects = [
        Subject(
            name=name, run=lambda name=name: log.append(name), warm_ups=warm_ups, most=most,
            before=lambda name=name: log.append(f'before {name}'),
        )
        for name, warm_ups, most in (('a', 1, None), ('b', 0, 2))
    ]  # fmt: skip
    told: list[tuple[int, int]] = []
    figures = measure(subjects, 3, lambda done, total: told.append((done, total)))

    turn = ['before a', 'a', 'before b', 'b']
    assert log == ['a', *turn, *turn, 'before a', 'a']
    assert {name: figure.repeats for name, figure in figures.items()} == {'a': 3, 'b': 2}
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_given_a_subject_that_times_its_parts_when_measured_then_only_they_have_figures() -> None:
    parts = iter([{'x': 10, 'y': 4}, {'x': 30, 'y': 4}])
    subject = Subject(name='a', run=lambda: next(parts), warm_ups=0)
    figures = measure([subject], 2)

    assert list(figures) == ['a/x', 'a/y']
    assert figures['a/x'].median_s == pytest.approx(2e-8)
    assert figures['a/x'].cpu_s is None


def test_given_a_subject_with_a_clock_of_its_own_when_measured_then_that_counts() -> None:
    clock, others = Clock(), Clock()

    def run() -> None:
        clock.now_ns += 10
        others.now_ns += 70

    subjects = [
        Subject(name='alone', run=run, warm_ups=0),
        Subject(name='with children', run=run, warm_ups=0, cpu=others),
    ]
    figures = measure(subjects, 1, wall=clock, cpu=clock)
    assert figures['alone'].cpu_s == pytest.approx(1e-8)
    assert figures['with children'].cpu_s == pytest.approx(7e-8)
