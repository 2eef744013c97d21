"""The shipped SROS2 policies are those of the nodes as they are, and of policy version 0.2.0."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from sros2_policies import FOLDER, SUPERVISOR, Interface, interfaces, policies

from taxinet_ros.cli.run.node import NODES

pytestmark = pytest.mark.ros

ALLOWED = {
    'topics': ({'publish', 'subscribe'}, 'topic'),
    'services': ({'reply', 'request'}, 'service'),
    'actions': ({'execute', 'call'}, 'action'),
}


@pytest.fixture(scope='module')
def found(bag: Path, tmp_path_factory) -> dict[str, tuple[str, Interface]]:
    return interfaces(bag, tmp_path_factory.mktemp('sros2'))


def test_given_the_nodes_as_they_run_then_the_shipped_policies_allow_that_and_no_more(found):
    shipped = {path.name: path.read_text(encoding='utf-8') for path in FOLDER.iterdir()}
    assert shipped == policies(found), 'sros2_policies.py writes them anew'
    assert set(found) == {*NODES, SUPERVISOR}
    speakers = {
        node for node, rules in found.values() if '/tf' in rules.get(('topics', 'publish'), ())
    }
    assert speakers == {'simulator', 'bag_player'}, 'the recorder makes what it writes of odometry'


@pytest.mark.parametrize('path', sorted(FOLDER.iterdir()), ids=lambda path: path.name)
def test_given_a_shipped_policy_then_its_structure_is_the_schemas(path: Path):
    root = ElementTree.parse(path).getroot()
    assert (root.tag, root.attrib) == ('policy', {'version': '0.2.0'})
    (enclaves,) = root
    (enclave,) = enclaves
    assert (enclaves.tag, enclave.tag) == ('enclaves', 'enclave')
    assert enclave.attrib == {'path': f'/taxinet/{path.name.partition(".")[0]}'}
    (profiles,) = enclave
    assert profiles.tag == 'profiles'
    assert len(profiles) > 0
    for profile in profiles:
        assert profile.tag == 'profile'
        assert set(profile.attrib) == {'ns', 'node'}
        assert len(profile) > 1
        for rules in profile:
            deeds, one = ALLOWED[rules.tag]
            ((deed, qualifier),) = rules.attrib.items()
            assert deed in deeds
            assert qualifier == 'ALLOW'
            assert len(rules) > 0
            assert {name.tag for name in rules} == {one}
            assert all((name.text or '').startswith(('/', '~/')) for name in rules)
