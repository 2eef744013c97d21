"""Extension points: what is known by name, where it comes from, and what goes wrong with it."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from plugins import lay_down

import taxinet_ros as tx
from taxinet_ros import registry
from taxinet_ros.core.motion.controller import check_controller, make_controller
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.perception.perception import check_perception, make_perception
from taxinet_ros.core.perception.weights import SHIPPED
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.types import TrackingError
from taxinet_ros.core.user_code import UserCodeError
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.samplers.registry import SAMPLERS, make_sampler
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.trials.requirements import read_specs

TRUTH = TrackingError(cte_m=1.0, he_rad=0.1)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of packages on Python's path, whose modules are forgotten at the end."""
    monkeypatch.syspath_prepend(str(tmp_path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        file = getattr(sys.modules[name], '__file__', None)
        if file and Path(file).is_relative_to(tmp_path):
            del sys.modules[name]


def test_given_what_is_shipped_when_installed_then_its_entry_points_are_those_of_the_table() -> (
    None
):
    for kind, targets in registry.SHIPPED.items():
        found = metadata.entry_points(group=f'taxinet_ros.{kind}')
        ours = {one.name: one.value for one in found if one.dist.name == 'taxinet_ros'}
        assert ours == dict(targets), kind


@pytest.mark.parametrize('kind', registry.SHIPPED)
def test_given_a_shipped_name_when_looked_up_then_it_loads(kind: str) -> None:
    for name in registry.names(kind):
        found = registry.find(kind, name)
        assert found is not None
        assert found.shipped
        assert found.load() is not None
    assert list(SHIPPED.values()) == [
        registry.find('perceptions', name).load() for name in SHIPPED
    ]


def test_given_no_plugins_when_looked_up_then_no_metadata_are_read() -> None:
    code = (
        'import sys; from taxinet_ros import registry; registry.find("samplers", "ce"); '
        'registry.plugins(); print("importlib.metadata" in sys.modules)'
    )
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert done.stdout == 'False\n'


def test_given_a_package_when_its_names_are_used_then_they_are_as_good_as_shipped_ones(
    site: Path,
) -> None:
    lay_down(
        site, 'our-parts',
        'def look(image):\n    return 1, 0.1\n'
        'def steer(estimate):\n    return -0.1, 5.0\n'
        'CALM = "always(abs(steering) <= 5 deg)"\n',
        perceptions='mine = look', controllers='mine = steer', requirements='calm = CALM',
    )
    perception, controller = make_perception('mine'), make_controller('mine', None)
    assert (perception.word, controller.word) == ('mine', 'mine')
    assert perception.fingerprint == check_perception('mine') == check_controller('mine')
    assert len(perception.fingerprint) == 64
    assert controller.command(TRUTH).steering_rad == -0.1
    assert registry.names('perceptions')[-1] == 'mine'
    assert parse_spec('calm').name == 'calm'
    assert read_specs(['calm', 'usable']) == (f'calm={parse_spec("calm").text}', 'usable')
    assert registry.plugins() == provenance()['plugins'] == 'our-parts 1.2'
    assert registry.origins(perceptions='mine', controllers='steering') == {'perceptions': {
        'name': 'mine', 'distribution': 'our-parts', 'version': '1.2',
        'sha256': perception.fingerprint,
    }}
    sys.path.remove(str(site))
    assert 'plugins' not in provenance()


def test_given_a_changed_package_when_fingerprinted_then_it_is_another_one(site: Path) -> None:
    lay_down(site, 'our-parts', 'def look(image):\n    return 1, 0.1\n', perceptions='mine = look')
    before = check_perception('mine')
    with (site / 'our_parts.py').open('a') as file:
        file.write('# changed\n')
    assert check_perception('mine') != before


@pytest.mark.parametrize(('record', 'text'), [
    ('RECORD', 'our_parts.py,,\nhelp.py,,\nour_parts-1.2.dist-info/METADATA,,\n../../bin/x,,\n'),
    ('top_level.txt', 'help\nour_parts\n'),
])
def test_given_a_second_module_of_a_package_when_it_changes_then_the_fingerprint_does(
    site: Path, record: str, text: str
) -> None:
    code = 'from our_help import look\n'
    lay_down(site, 'our-parts', code, perceptions='mine = look')
    (site / 'our_help.py').write_text('def look(image):\n    return 1, 0.1\n')
    alone = registry.find('perceptions', 'mine').fingerprint
    (site / 'our_parts-1.2.dist-info' / record).write_text(text.replace('help', 'our_help'))
    before = check_perception('mine')
    assert before != alone
    with (site / 'our_help.py').open('a') as file:
        file.write('# changed\n')
    assert check_perception('mine') != before
    lay_down(site, 'unrelated', '')
    assert registry.find('perceptions', 'mine').fingerprint == check_perception('mine')


def test_given_a_file_of_weights_when_a_package_names_it_then_it_is_the_network(
    site: Path,
) -> None:
    code = f'from pathlib import Path\nNET = Path({str(SHIPPED["taxinet"])!r})\n'
    lay_down(site, 'our-net', code, perceptions='ours = NET')
    found = make_perception('ours')
    assert found.word == 'ours'
    assert found.fingerprint == check_perception('taxinet') == check_perception('ours')


@pytest.mark.parametrize('image', [
    'np.zeros((100, 100, 3), np.uint8)', 'np.zeros((200, 360, 3), np.float32)',
])
def test_given_a_world_whose_pictures_are_no_frames_then_the_run_is_none(
    site: Path, image: str,
) -> None:
    code = (
        'import dataclasses\nimport numpy as np\n'
        'from taxinet_ros.core.world import SimulatedWorld\n'
        'class Elsewhere(SimulatedWorld):\n'
        '    def observe(self, *, picture=True):\n'
        f'        return dataclasses.replace(super().observe(picture=picture), image={image})\n'
    )
    lay_down(site, 'our-world', code, worlds='elsewhere = Elsewhere')
    with pytest.raises(InfraError, match='the picture is'):
        tx.run(tx.Scenario(duration_s=0.5), perception='original', world='elsewhere')


def test_given_a_world_that_shows_nobody_else_then_a_scene_with_others_is_refused_by_name(
    site: Path,
) -> None:
    code = 'from taxinet_ros.core.world import SimulatedWorld\nclass Own(SimulatedWorld):\n    '
    lay_down(site, 'empty-world', code + 'pass\n', worlds='empty = Own')
    lay_down(site, 'busy-world', code + 'shows_traffic = True\n', worlds='busy = Own')
    crowded = tx.Scenario(traffic=tx.load_traffic([{'kind': 'cone', 'x_m': 420, 'y_m': 3}]))
    with pytest.raises(UsageError, match=r'empty-world 1\.2: the world does not show traffic'):
        find_world('empty').make(crowded)
    assert find_world('empty').make(tx.Scenario()).last_seq == 300
    assert find_world('busy').make(crowded).last_seq == 300
    shy = tx.Scenario(traffic=tx.load_traffic([
        {'kind': 'vehicle', 'x_m': 420, 'y_m': 3, 'stands_within_m': 9,
         'path': [{'x_m': 420, 'y_m': -3, 'speed_mps': 3}]},
    ]))
    with pytest.raises(UsageError, match=r'busy-world 1\.2: objects\[0\] of traffic reacts to the'):
        find_world('busy').make(shy)


def lay_down_world(site: Path, body: str, first: str = '') -> None:
    """A package's world: the simulated one, but for ``body``; ``now`` is what that one observes."""
    lay_down(site, 'our-world', (
        'import dataclasses, sys\nimport numpy as np\n'
        'from taxinet_ros.core.world import SimulatedWorld\n'
        f'{first}\n'
        'class Elsewhere(SimulatedWorld):\n'
        '    def observe(self, *, picture=True):\n'
        '        now = super().observe(picture=picture)\n'
        f'        {body}\n'
    ), worlds='elsewhere = Elsewhere')


def test_given_a_world_without_pictures_then_only_who_needs_none_runs_in_it(site: Path) -> None:
    lay_down_world(site, 'return dataclasses.replace(now, image=None)')
    asked = tx.Scenario(duration_s=0.5)
    assert tx.run(asked, world='elsewhere').outcome == 'PASS'
    for word in ('original', lambda frame: (0.0, 0.0)):
        with pytest.raises(InfraError, match=r'at step 0: .*no picture, which perception \S+ n'):
            tx.run(asked, perception=word, world='elsewhere')


@pytest.mark.parametrize(('body', 'words'), [
    ('return dataclasses.replace(now, stamp_ns=2 * now.stamp_ns)', 'observed stamp 200000000 ns'),
    ('return dataclasses.replace(now, state=(1, 2, 3))', 'the state is tuple'),
    ('return dataclasses.replace(now, seq=None)', 'observed step None, expected 0'),
    ('sys.exit(0)', 'SystemExit: 0'),
])
def test_given_a_world_that_breaks_its_contract_then_the_run_fails_and_the_process_goes_on(
    site: Path, body: str, words: str
) -> None:
    lay_down_world(site, body)
    with pytest.raises(InfraError, match=words):
        tx.run(tx.Scenario(duration_s=0.5), world='elsewhere')


def test_given_a_world_that_knows_no_tracks_when_one_is_asked_for_then_it_is_refused(
    site: Path,
) -> None:
    lay_down_world(
        site, 'away = dataclasses.replace(now.state, x_m=400.0, y_m=0.0)\n'
        '        return dataclasses.replace(now, state=away)',
    )
    tx.run(tx.Scenario(duration_s=0.5), specs='phi_always', world='elsewhere')
    with pytest.raises(InfraError, match=r'begins \d+.\d m from its start on the track exit_left'):
        tx.run(
            tx.Scenario(duration_s=0.5, track='exit_left'), specs='phi_always', world='elsewhere',
        )


def test_given_a_world_that_paints_over_its_picture_then_each_frame_of_a_run_stays_its_own(
    site: Path,
) -> None:
    lay_down_world(
        site, 'SHEET[:] = now.seq\n        return dataclasses.replace(now, image=SHEET)',
        'SHEET = np.zeros((200, 360, 3), np.uint8)',
    )
    run = tx.run(tx.Scenario(duration_s=0.3), specs='phi_always', world='elsewhere')
    assert [frame[0, 0, 0] for frame in list(run.frames())] == [0, 1, 2, 3]


def test_given_a_world_that_is_another_each_time_then_no_picture_is_taken_for_one_of_the_run(
    site: Path, tmp_path: Path
) -> None:
    lay_down_world(
        site, 'state = dataclasses.replace(now.state, y_m=float(next(NUMBERS)))\n'
        '        return dataclasses.replace(now, state=state)',
        'import itertools\nNUMBERS = itertools.count()',
    )
    run = tx.run(tx.Scenario(duration_s=0.3), specs='phi_always', world='elsewhere')
    for ask in (lambda: run.frame(1), lambda: list(run.frames()),
                lambda: run.save_bag(tmp_path / 'saved')):
        with pytest.raises(InfraError, match='is elsewhere when the same run is driven'):
            ask()
    assert not list(tmp_path.glob('*saved*'))


UNKNOWN = {
    'perceptions': lambda: make_perception('nobody'),
    'controllers': lambda: make_controller('nobody', None),
    'samplers': lambda: make_sampler('nobody', (), 0, 1),
    'worlds': lambda: find_world('nobody'),
    'requirements': lambda: parse_spec('nobody'),
}


@pytest.mark.parametrize('kind', UNKNOWN)
def test_given_an_unknown_name_when_used_then_the_known_ones_and_whence_more_come_are_told(
    kind: str, site: Path
) -> None:
    lay_down(site, 'our-parts', '', **{kind: 'mine = MINE'})
    with pytest.raises(UsageError, match='nobody') as caught:
        UNKNOWN[kind]()
    assert all(name in str(caught.value) for name in (*registry.SHIPPED[kind], 'mine'))
    assert f'packages add more by taxinet_ros.{kind}' in str(caught.value)


def test_given_two_packages_with_one_name_when_used_then_both_are_named(site: Path) -> None:
    lay_down(site, 'ours', 'def look(image): ...\n', perceptions='mine = look')
    lay_down(site, 'theirs', 'def look(image): ...\n', '3.4', perceptions='mine = look')
    for use in (make_perception, check_perception):
        with pytest.raises(
            UsageError, match=r'perception mine: there are two, of ours 1\.2 .* and theirs 3\.4'
        ):
            use('mine')
    assert check_perception('truth') == ''


def test_given_a_package_with_a_shipped_name_when_used_then_neither_is_taken(site: Path) -> None:
    lay_down(site, 'ours', 'def steer(estimate): ...\n', controllers='steering = steer')
    with pytest.raises(UsageError, match=r'controller steering: there are two, of taxinet_ros .*'):
        check_controller('steering')


def test_given_a_package_with_a_shipped_requirement_when_used_then_neither_is_taken(
    site: Path,
) -> None:
    lay_down(site, 'ours', "MINE = 'always(speed <= 6)'\n", requirements='phi_always = MINE')
    with pytest.raises(UsageError, match=r'requirement phi_always: there are two, of taxinet_ros'):
        parse_spec('phi_always')
    assert parse_spec('on_runway').name == 'on_runway'


@pytest.mark.parametrize('name', ['external', 'onnx', 'a.b'])
def test_given_a_name_that_means_something_else_when_used_then_it_is_refused(
    site: Path, name: str
) -> None:
    lay_down(site, 'ours', 'def look(image): ...\n', perceptions=f'{name} = look')
    with pytest.raises(UsageError, match=r'of ours 1\.2: the name cannot be used'):
        check_perception(name, graph=True)


BROKEN = {
    'no such object': ('', 'AttributeError'),
    'fails': ('1 / 0', 'ZeroDivisionError: division by zero'),
    'exits': ('raise SystemExit(0)', 'SystemExit: 0'),
    'needs what is not there': ('import no_such_module', "No module named 'no_such_module'"),
    'is no function': ('THING = 3', 'is int; expected a function or class'),
}


@pytest.mark.parametrize('case', BROKEN)
def test_given_a_package_that_does_not_load_when_named_then_one_line_says_whose_it_is(
    site: Path, case: str
) -> None:
    code, said = BROKEN[case]
    lay_down(site, f'broken{len(case)}', code, perceptions='mine = THING')
    with pytest.raises(UsageError, match=rf'perception mine of broken{len(case)} 1\.2: ') as caught:
        check_perception('mine')
    assert said in str(caught.value)
    assert '\n' not in str(caught.value)
    assert check_perception('truth') == ''


def test_given_a_function_that_fails_amid_a_run_when_called_then_its_line_is_told(
    site: Path,
) -> None:
    lay_down(site, 'failing', 'def steer(estimate):\n    return 1 / 0\n', controllers='bad = steer')
    with pytest.raises(UserCodeError, match=r'bad of failing 1\.2: .*failing\.py:2: ZeroDiv'):
        make_controller('bad', None).command(TRUTH)


def test_given_samplers_of_packages_when_they_fail_then_one_line_says_whose_they_are(
    site: Path,
) -> None:
    code = """
from taxinet_ros.samplers.registry import SamplerKind

class Wrong:
    def ask(self):
        return (7.0,)

WRONG = SamplerKind(meaning='wrong', make=lambda space, seed, runs, values: Wrong())
NONE = 3
"""
    lay_down(site, 'their-sampler', code, samplers='wrong = WRONG')
    lay_down(site, 'no-sampler', 'NONE = 3\n', samplers='none = NONE')
    with pytest.raises(UsageError, match=r'sampler wrong of their-sampler 1\.2: .*within \[0, 1\)'):
        make_sampler('wrong', (Dimension(name='x'),), 0, 1).next()
    with pytest.raises(UsageError, match='is int; expected a SamplerKind'):
        SAMPLERS['none']
    assert make_sampler('random', (Dimension(name='x'),), 0, 1).next()


def test_given_a_requirement_that_is_no_formula_when_named_then_its_package_is_told(
    site: Path,
) -> None:
    lay_down(site, 'our-specs', 'BAD = "always(ctee <= 1)"\n', requirements='bad = BAD')
    lay_down(site, 'more-specs', 'BAD = 3\n', requirements='worse = BAD')
    with pytest.raises(UsageError, match=r'requirement bad of our-specs 1\.2: .*ctee'):
        parse_spec('bad')
    with pytest.raises(UsageError, match='is int; expected the text of a formula'):
        parse_spec('worse')


DOCUMENTED = {
    registry.PERCEPTIONS: 'networks.md', registry.SAMPLERS: 'falsification.md',
    registry.REQUIREMENTS: 'mtl.md',
}


@pytest.mark.parametrize('kind', DOCUMENTED)
def test_given_what_is_shipped_then_its_page_tells_of_each_by_name(kind: str) -> None:
    page = (Path(__file__).parents[1] / 'docs' / DOCUMENTED[kind]).read_text(encoding='utf-8')
    told = set(re.findall(r'`([^`\n]+)`', page)) | {
        f'iterative{word}' for word in re.findall(r'`(-\w+)`', page)
    }
    assert [name for name in registry.names(kind) if name not in {*told, 'truth'}] == []
