"""The table of topics is the graph: nodes, bags and docs say the same."""

from pathlib import Path

import pytest

from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.runtime_monitor import RuntimeMonitor

ROOT = Path(__file__).resolve().parents[2]


def documented_rows() -> dict[str, list[str]]:
    """Cells of the topic table of docs/graph.md by topic name."""
    rows = {}
    for line in (ROOT / 'docs' / 'graph.md').read_text().splitlines():
        cells = [cell.strip().strip('`') for cell in line.strip('|').split('|')]
        if len(cells) == 6 and '/msg/' in cells[1]:
            rows[cells[0]] = cells
    return rows


def test_given_the_docs_then_their_topic_table_is_the_codes():
    rows = documented_rows()
    assert set(rows) == {topic.name for topic in interface.TOPICS}
    for topic in interface.TOPICS:
        latched = 'latched' if topic.qos is interface.LATCHED else 'lockstep'
        assert rows[topic.name] == [
            topic.name, topic.type_name, latched, ', '.join(topic.publishers),
            topic.recorded or 'no', topic.carries,
        ]


@pytest.mark.ros
@pytest.mark.parametrize('perception', ['truth', 'taxinet'])
def test_given_the_graph_then_its_nodes_speak_and_listen_as_the_table_says(perception, tmp_path):
    with composed_graph(GraphOptions(perception=perception, out=tmp_path)) as graph:
        graph._spinning.add(RuntimeMonitor(context=graph._spinning.context))
        nodes = {node.get_name(): node for node in graph.nodes}
        assert set(nodes) == {interface.SIMULATOR, *interface.PARTICIPANTS, *interface.BESIDE}
        said: dict[str, set[str]] = {}
        heard: dict[str, set[str]] = {}
        for name, node in nodes.items():
            said[name] = {publisher.topic_name for publisher in node.publishers}
            heard[name] = {one.topic_name for one in node.subscriptions}
    eyes = {'truth': interface.TRUTH, 'taxinet': interface.IMAGE}
    for topic in interface.TOPICS:
        path = '/' + topic.name.lstrip('/')
        assert {name for name in said if path in said[name]} == set(topic.publishers), path
        listeners = {name for name in heard if path in heard[name]}
        expected = set(topic.subscribers)
        if topic.recorded:
            expected.add(interface.RECORDER)
        if topic in eyes.values():
            expected.discard(interface.PERCEPTION)
            if topic is eyes[perception]:
                expected.add(interface.PERCEPTION)
        assert listeners == expected, path
