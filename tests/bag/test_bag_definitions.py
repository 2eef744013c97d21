"""Definitions and hashes from installed files, held against rosbags' own knowledge of Jazzy."""

from __future__ import annotations

from pathlib import Path

import bag_samples
import pytest
from rosbags.typesys import get_types_from_msg

from taxinet_ros.bag import topics as bag_topics
from taxinet_ros.bag.topics import describe_topic, message_definition, type_hash
from taxinet_ros.core import topics
from taxinet_ros.errors import UsageError

ROOT = Path(__file__).resolve().parents[2]
INSTALLED = [
    'std_msgs/msg/Header', 'std_msgs/msg/String', 'sensor_msgs/msg/Image',
    'sensor_msgs/msg/CameraInfo', 'nav_msgs/msg/Odometry', 'rosgraph_msgs/msg/Clock',
    'diagnostic_msgs/msg/DiagnosticArray', 'taxinet_msgs/msg/TrackingError',
    'taxinet_msgs/msg/TaxiCommand', 'taxinet_msgs/msg/Robustness', 'taxinet_msgs/msg/Verdict',
    'taxinet_msgs/msg/Scenario', 'taxinet_msgs/msg/NodeStatus', 'taxinet_msgs/msg/RunStatus',
]


@pytest.mark.parametrize('type_name', INSTALLED)
def test_given_an_installed_type_when_described_then_closure_and_hash_are_right(
    type_name: str,
) -> None:
    store = bag_samples.store()
    topic = describe_topic(name='/t', type_name=type_name, qos=bag_samples.QOS)
    parsed = get_types_from_msg(topic.definition, type_name)
    assert type_name in parsed
    for name, (_, fields) in parsed.items():
        assert fields == store.fielddefs[name][1], name
    wanted, todo = set(), [type_name]
    while todo:
        wanted.add(name := todo.pop())
        todo += [t for t in _inner(store.fielddefs[name][1]) if t not in wanted]
    assert set(parsed) == wanted
    assert topic.type_hash == store.hash_rihs01(type_name)


def _inner(fields: object) -> set[str]:
    """Names of message types anywhere within rosbags' field descriptions."""
    if isinstance(fields, str):
        return {fields} if '/msg/' in fields else set()
    if isinstance(fields, tuple | list):
        return set().union(*map(_inner, fields))
    return set()


def test_given_nested_packages_when_expanded_then_order_is_depth_first_by_name(
    tmp_path: Path,
) -> None:
    leaves = ['H', 'D', 'F', 'C', 'G', 'E']
    fields = ''.join(f'b/{leaf} {leaf.lower()}\n' for leaf in leaves)
    top = 'b/Zed[3] zed  # or a/Unused other\nInner inner\nuint8 X=1\n' + fields
    _install(tmp_path, 'a', 'Top', top)
    for leaf in leaves:
        _install(tmp_path, 'b', leaf, 'Low low\n')
    _install(tmp_path, 'a', 'Inner', '# nothing/Here is a comment\nb/Low[<=2] low\nstring<=5 s\n')
    _install(tmp_path, 'b', 'Zed', 'Low low\n')
    _install(tmp_path, 'b', 'Low', 'float64 x 1.5')
    text = message_definition('a/msg/Top', [tmp_path])
    heads = [line for line in text.splitlines() if line.startswith('MSG: ')]
    order = ['a/Inner', 'b/Low', *(f'b/{leaf}' for leaf in 'CDEFGH'), 'b/Zed']
    assert heads == [f'MSG: {name}' for name in order]
    assert text.count('=' * 80 + '\n') == len(order)
    assert text.startswith('b/Zed[3] zed')


def test_given_prefixes_when_looked_up_then_the_first_wins_and_else_those_of_ament(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _install(tmp_path / 'one', 'a', 'Top', 'uint8 x\n')
    _install(tmp_path / 'two', 'a', 'Top', 'uint16 x\n')
    both = [tmp_path / 'one', tmp_path / 'two']
    assert message_definition('a/msg/Top', both) == 'uint8 x\n'
    assert message_definition('a/msg/Top', both[::-1]) == 'uint16 x\n'
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'/nowhere:{tmp_path / "one"}')
    assert message_definition('a/msg/Top') == 'uint8 x\n'


@pytest.mark.parametrize('type_name', ['no_such_msgs/msg/Thing', 'std_msgs/msg/Thing'])
def test_given_a_type_that_is_not_installed_when_looked_up_then_one_line_says_so(
    type_name: str,
) -> None:
    for look_up in (message_definition, type_hash):
        with pytest.raises(UsageError, match=rf'^{type_name}: .*install package') as caught:
            look_up(type_name)
        assert '\n' not in str(caught.value)


@pytest.mark.parametrize('name', ['../../etc/passwd', 'std_msgs/String', 'a/msg/../b', ''])
def test_given_a_malformed_type_name_when_looked_up_then_refused(name: str) -> None:
    with pytest.raises(UsageError, match='not of the form package/msg/Name'):
        message_definition(name)


@pytest.mark.parametrize('text', ['', '{}', '{"type_hashes": []}', '[1]'])
def test_given_a_description_without_hash_when_looked_up_then_refused(
    tmp_path: Path, text: str
) -> None:
    _install(tmp_path, 'a', 'Top', 'uint8 x\n')
    (tmp_path / 'share/a/msg/Top.json').write_text(text)
    with pytest.raises(UsageError, match='names no type hash'):
        type_hash('a/msg/Top', [tmp_path])


def _install(prefix: Path, package: str, name: str, text: str) -> None:
    folder = prefix / 'share' / package / 'msg'
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f'{name}.msg').write_text(text)


def test_given_no_ros_then_each_recorded_type_is_the_installed_one() -> None:
    """The hash is of names and types of all fields (REP-2016), so comments alone may differ."""
    recorded = [one.type_name for one in topics.TOPICS + topics.TRANSFORMS if one.recorded]
    assert len(recorded) == 18
    for name in recorded:
        assert bag_topics._hash(name, (bag_topics._OURS,)) == type_hash(name)


def test_given_our_definitions_then_they_are_those_that_the_interface_package_is_made_of() -> None:
    files = {file.name: file.read_text() for file in (ROOT / 'msg_defs' / 'msg').iterdir()}
    ours = bag_topics._OURS / 'share' / 'taxinet_msgs' / 'msg'
    assert {file.name: file.read_text() for file in ours.iterdir()} == files
