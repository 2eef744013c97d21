"""Messages of control steps come out as whole steps, in order, in whatever order they arrive."""

from hypothesis import given
from hypothesis import strategies as st

from taxinet_ros.core.pacing.step_collector import FreeProgress, StepCollector
from taxinet_ros.core.topics import COMMAND, ESTIMATE

EXPECTED = {'image': 1, 'truth': 1, 'robustness': 2}
MESSAGES = [
    (topic, seq, f'{topic}-{seq}-{i}')
    for seq in range(5) for topic, count in EXPECTED.items() for i in range(count)
]


def by_topic(seq: int) -> dict[str, list[str]]:
    return {
        topic: [f'{topic}-{seq}-{i}' for i in range(count)] for topic, count in EXPECTED.items()
    }


@given(st.permutations(MESSAGES))
def test_given_messages_in_any_order_then_whole_steps_come_out_in_order(messages):
    collector = StepCollector(EXPECTED)
    steps = [step for topic, seq, m in messages for step in collector.add(topic, seq, m)]
    assert [seq for seq, _ in steps] == [0, 1, 2, 3, 4]
    for seq, content in steps:
        assert {topic: sorted(found) for topic, found in content.items()} == by_topic(seq)
    assert collector.torn() == []


def test_given_repeated_messages_then_they_are_counted_and_ignored():
    collector = StepCollector({'image': 1, 'truth': 1})
    assert list(collector.add('image', 0, 'first')) == []
    assert list(collector.add('image', 0, 'again')) == []
    steps = list(collector.add('truth', 0, 'truth'))
    assert steps == [(0, {'image': ['first'], 'truth': ['truth']})]
    assert list(collector.add('truth', 0, 'late')) == []
    assert collector.repeated == 2


def test_given_a_run_that_stops_then_what_was_begun_is_still_there():
    collector = StepCollector({'image': 1, 'truth': 1})
    list(collector.add('image', 1, 'b'))
    list(collector.add('image', 0, 'a'))
    assert collector.torn() == [(0, {'image': ['a']}), (1, {'image': ['b']})]


def test_given_answers_that_frames_do_not_get_then_their_steps_are_whole_without_them():
    collector = StepCollector({'truth': 1, ESTIMATE.name: 1, COMMAND.name: 1})
    for seq in (0, 1):
        assert list(collector.add('truth', seq, f't{seq}')) == []
    collector.add(ESTIMATE.name, 1, 'e1')
    assert collector.settle([0], [1]) == []
    assert collector.settle([], [0]) == [
        (0, {'truth': ['t0']}), (1, {'truth': ['t1'], ESTIMATE.name: ['e1']}),
    ]
    assert list(collector.add(COMMAND.name, 0, 'late')) == []
    assert collector.repeated == 1


def test_given_a_follower_of_a_free_run_then_it_reports_what_is_new():
    progress = FreeProgress(['odometry', 'truth'])
    assert not progress.arrived('command', 3)
    assert progress.arrived('odometry', 3)
    assert progress.news(-1) == (0, 0)
    assert progress.news(-1) is None
    progress.arrived('truth', 2)
    assert progress.news(1) == (1, 2)
