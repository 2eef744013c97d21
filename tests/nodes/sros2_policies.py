"""SROS2 policies out of what running nodes say of themselves; as a script it writes the files.

``PYTHONPATH=tests python tests/nodes/sros2_policies.py`` writes ``docs/sros2/policies`` anew. The
form is that of policy version 0.2.0,
https://design.ros2.org/articles/ros2_access_control_policies.html with the enclaves of
https://design.ros2.org/articles/ros2_security_enclaves.html.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from graph_runs import class_of, judged_in, on_own_domain, request
from rclpy.context import Context
from rclpy.parameter import Parameter

from taxinet_ros.cli.run.node import NODES
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS, SIMULATOR

FOLDER = Path(__file__).parents[2] / 'docs' / 'sros2' / 'policies'
ENCLAVES = '/taxinet'
TOGETHER = 'campaign'
"""The enclave of all nodes of a campaign, for those that share one process or one environment."""

SUPERVISOR = 'supervisor'
"""The node of ``taxinet up``, which is no executable of its own."""

_ACTION = '/_action/'
_RULES = (
    ('topics', 'publish', 'topic'), ('topics', 'subscribe', 'topic'),
    ('services', 'reply', 'service'), ('services', 'request', 'service'),
    ('actions', 'execute', 'action'), ('actions', 'call', 'action'),
)
_COMPOSED = ('simulator', 'taxinet_perception', 'ground_truth_perception', 'steering_controller',
             'mtl_monitor', 'recorder', 'scenario_sampler', SUPERVISOR)

Interface = Mapping[tuple[str, str], list[str]]
"""Names by element and what is allowed with them, such as ('topics', 'publish')."""


def interfaces(bag: Path, folder: Path) -> dict[str, tuple[str, Interface]]:
    """Name of the node and its interface, by executable, of nodes that run for a moment.

    Args:
        bag: a whole run with camera frames, for the player.
        folder: where the recorder would write.
    """
    found = {}
    given = {
        'recorder': {'out': str(folder)}, 'foxglove_server': {'port': 0},
        'scenario_sampler': {'program': 'nominal', 'out': f'{folder}/new'},
        'bag_player': {'bag': str(bag)},
    }
    for executable in (*NODES, SUPERVISOR):
        build = _supervisor if executable == SUPERVISOR else class_of(executable)
        with on_own_domain() as spinning:
            overrides = [Parameter(name, value=x) for name, x in given.get(executable, {}).items()]
            node = build(context=spinning.context, parameter_overrides=overrides)
            spinning.add(node)
            if hasattr(node, '_join'):
                node._join()  # an onlooker subscribes when a run begins
            found[executable] = node.get_name(), interface_of(node)
    return found


def _supervisor(context: Context, parameter_overrides: list[Parameter]) -> Any:
    """One that looks after the nodes of a graph, none of which is there."""
    from taxinet_ros.nodes.graph.supervisor import Supervisor

    processes: Any = [SimpleNamespace(name=name) for name in (SIMULATOR, *PARTICIPANTS)]
    return Supervisor(processes, print, context=context)


def interface_of(node: Any) -> Interface:
    """Every topic, service and action of a node, as ROS knows them."""
    own = (node.get_name(), node.get_namespace())
    names = {
        'publish': node.get_publisher_names_and_types_by_node(*own),
        'subscribe': node.get_subscriber_names_and_types_by_node(*own),
        'reply': node.get_service_names_and_types_by_node(*own),
        'request': node.get_client_names_and_types_by_node(*own),
    }
    plain = {
        deed: sorted({
            _shown(name, node) if deed in ('reply', 'request') else name
            for name, _ in pairs if _ACTION not in name
        })
        for deed, pairs in names.items()
    }
    for deed, of in (('execute', 'reply'), ('call', 'request')):
        actions = {name.partition(_ACTION)[0] for name, _ in names[of] if _ACTION in name}
        plain[deed] = sorted(actions)
    return {(element, deed): plain[deed] for element, deed, _ in _RULES if plain[deed]}


def _shown(name: str, node: Any) -> str:
    """As a policy spells a service: private ones with ~, others in full."""
    private = f'/{node.get_name()}/'
    return f'~/{name.removeprefix(private)}' if name.startswith(private) else name


def policy(enclave: str, profiles: Mapping[str, Interface]) -> str:
    """The text of a policy file with one enclave and a profile for each of some nodes."""
    root = ElementTree.Element('policy', version='0.2.0')
    place = ElementTree.SubElement(
        ElementTree.SubElement(root, 'enclaves'), 'enclave', path=f'{ENCLAVES}/{enclave}')
    within = ElementTree.SubElement(place, 'profiles')
    for node, rules in profiles.items():
        profile = ElementTree.SubElement(within, 'profile', ns='/', node=node)
        for element, deed, one in _RULES:
            if (element, deed) not in rules:
                continue
            listed = ElementTree.SubElement(profile, element, {deed: 'ALLOW'})
            for name in rules[element, deed]:
                ElementTree.SubElement(listed, one).text = name
    ElementTree.indent(root)
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    return head + ElementTree.tostring(root, encoding='unicode') + '\n'


def policies(found: Mapping[str, tuple[str, Interface]]) -> dict[str, str]:
    """Text by file name: one for each executable, and one for a campaign in one process."""
    files = {
        f'{executable}.policy.xml': policy(executable, {node: rules})
        for executable, (node, rules) in found.items() if executable != SUPERVISOR
    }
    together: dict[str, Interface] = {}
    for executable in _COMPOSED:
        node, rules = found[executable]
        before = together.get(node, {})
        together[node] = {
            rule: sorted({*before.get(rule, ()), *rules.get(rule, ())})
            for rule in dict.fromkeys([*before, *rules])
        }
    return {**files, f'{TOGETHER}.policy.xml': policy(TOGETHER, together)}


def record(folder: Path) -> Path:
    """A short run's bag, camera frames included."""
    graph = composed_graph(GraphOptions(perception='truth', out=folder))
    judged_in(graph, request('short', 0.5))
    return folder / 'short'


def main() -> None:
    """Write the files anew."""
    with tempfile.TemporaryDirectory() as scratch:
        found = interfaces(record(Path(scratch)), Path(scratch))
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in policies(found).items():
        (FOLDER / name).write_text(text, encoding='utf-8')


if __name__ == '__main__':
    main()
