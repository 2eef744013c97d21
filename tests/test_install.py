"""What pip and colcon lay down: libraries, messages, executables for ``ros2 run``, shared files."""

from __future__ import annotations

import ast
import importlib
import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
import taxinet_msgs.action
import taxinet_msgs.msg
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import taxinet_ros
from taxinet_ros.cli.messages import setup_messages
from taxinet_ros.errors import UsageError

pytestmark = pytest.mark.nightly

REPOSITORY = Path(__file__).resolve().parent.parent
PREFIX = Path(sys.prefix)
EXECUTABLES = {
    'bag_player',
    'foxglove_server',
    'ground_truth_perception',
    'live_monitor',
    'mtl_monitor',
    'recorder',
    'runtime_monitor',
    'scenario_sampler',
    'scene_markers',
    'simulator',
    'steering_controller',
    'taxinet',
    'taxinet_perception',
}
LIVE = 'taxinet_ros.extras.live_monitor.node'
TF2_MSGS = REPOSITORY / 'msg_defs' / 'tf2_msgs'
MESSAGES = sorted((REPOSITORY / 'msg_defs' / 'msg').glob('*.msg'))
ROS_NAME = re.compile(r'<(?:depend|exec_depend)>(\w+)</')


def run(*command: str | Path, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run a command to its end, its output as text."""
    return subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, **more
    )


def fields_in(definition: Path) -> list[str]:
    """Names of the fields of a .msg file, constants left out."""
    lines = [line.split('#')[0].split() for line in definition.read_text().splitlines()]
    return [words[1] for words in lines if len(words) == 2 and '=' not in words[1]]


def shipped_files() -> list[Path]:
    """Files of the repository that belong below share/taxinet_ros."""
    folders = [REPOSITORY / name for name in ('config', 'launch', 'scenarios')]
    found = [path for folder in folders for path in folder.rglob('*') if path.is_file()]
    return [path for path in found if '__pycache__' not in path.parts]


def imported_packages() -> set[str]:
    """Top-level names that taxinet_ros imports, the standard library's left out."""
    names = set()
    for path in (REPOSITORY / 'taxinet_ros').rglob('*.py'):
        for statement in ast.walk(ast.parse(path.read_text())):
            if isinstance(statement, ast.Import):
                names |= {alias.name.split('.')[0] for alias in statement.names}
            elif isinstance(statement, ast.ImportFrom) and statement.module:
                names.add(statement.module.split('.')[0])
    return names - set(sys.stdlib_module_names) - {'taxinet_ros'}


def requirements() -> list[Requirement]:
    """Everything that setup.py asks for, extras included."""
    return [Requirement(text) for text in metadata.requires('taxinet_ros') or []]


def test_given_two_opencv_builds_when_one_is_imported_then_it_needs_no_display() -> None:
    cv2 = importlib.import_module('cv2')
    assert re.search(r'GUI: +NONE', cv2.getBuildInformation())


def test_given_the_environment_when_pip_checks_it_then_nothing_is_missing_or_clashes() -> None:
    done = run(sys.executable, '-m', 'pip', 'check')
    assert done.returncode == 0, done.stdout


def test_given_the_requirements_when_compared_with_constraints_then_each_is_at_its_pin() -> None:
    stock = Version(metadata.version('numpy')).major == 1
    pins = pins_of('constraints-noble.txt' if stock else 'constraints.txt')
    names = [canonicalize_name(requirement.name) for requirement in requirements()]
    assert len(names) > 20
    installed = {name: Version(metadata.version(name)).public for name in names}
    assert installed == {name: pins.get(name) for name in names}


def pins_of(name: str) -> dict[str, str]:
    lines = (REPOSITORY / name).read_text().splitlines()
    return dict(line.split('==') for line in lines if '==' in line and not line.startswith('#'))


def test_given_the_pins_for_ubuntu_24_04_then_they_differ_where_numpy_1_asks_for_it() -> None:
    pins, noble = pins_of('constraints.txt'), pins_of('constraints-noble.txt')
    assert {name for name in {*pins, *noble} if pins.get(name) != noble.get(name)} == {
        'numpy', 'opencv-python', 'opencv-python-headless', 'pandas', 'pyarrow', 'ml-dtypes'}
    assert noble['numpy'] == '1.26.4'
    words = ['make', '-n', 'install', 'HASHES=yes', 'CONSTRAINTS=constraints-noble.txt']
    done = run(*words, cwd=REPOSITORY)
    assert done.returncode == 2
    assert 'HASHES names the files of constraints.txt' in done.stderr


def test_f10_given_the_pins_then_each_has_hashes_and_a_maker_of_them() -> None:
    pins = re.findall(r'^([\w.-]+)==(\S+)$', (REPOSITORY / 'constraints.txt').read_text(), re.M)
    text = (REPOSITORY / 'hashes.txt').read_text().replace('\\\n', '')
    lines = [line.split() for line in text.splitlines() if not line.startswith('#')]
    assert len(lines) > 200
    assert {line[0] for line in lines} == {f'{canonicalize_name(n)}=={v}' for n, v in pins}
    hashes = re.compile(r'(--hash=sha256:[0-9a-f]{64} ?)+')
    assert [line[0] for line in lines if not hashes.fullmatch(' '.join(line[1:]))] == []
    for user in ('Makefile', '.ci/run', '.ci/hashes.py'):
        assert 'HASHES=yes' in (REPOSITORY / user).read_text()


@pytest.mark.parametrize('goal', ['docs', 'test'])
@pytest.mark.parametrize('done', [(), ('packages', 'messages', 'tools')])
def test_people4_given_an_environment_of_another_checkout_then_make_leaves_it_alone(
    tmp_path: Path, goal: str, done: tuple[str, ...],
) -> None:
    python = tmp_path / '.venv' / 'bin' / 'python'  # ours, which installs nothing
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\ncase $1 in -c) exec {sys.executable} "$@";; esac; exit 9\n')
    python.chmod(0o755)
    for name in ('.venv/done/venv', 'resource/taxinet_ros', 'setup.py', 'package.xml',
                 'pyproject.toml', 'constraints.txt', 'hashes.txt',
                 *(f'.venv/done/{name}' for name in done)):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    alone = {name: value for name, value in os.environ.items() if not name.startswith('MAKE')}
    ended = run('make', '-f', REPOSITORY / 'Makefile', goal, cwd=tmp_path, env=alone)
    assert ended.returncode == 2
    assert f'.venv belongs to the checkout in {REPOSITORY}; name another one' in ended.stderr
    assert ended.stdout == ''


@pytest.mark.parametrize(('end', 'code'), [('true', 0), ('kill -9 $$$$', 2)])
def test_given_a_long_installation_then_make_says_that_it_works_and_stops_when_it_is_over(
    tmp_path: Path, end: str, code: int
) -> None:
    text = (REPOSITORY / 'Makefile').read_text()
    silent = [line for line in text.splitlines() if '$(INSTALL) --no-build-isolation' in line]
    assert len(silent) >= 2
    assert [line for line in silent if '$(BEAT);' not in line] == []
    (tmp_path / 'sleep').write_text('#!/bin/sh\nexec /bin/sleep 0.05\n')
    (tmp_path / 'sleep').chmod(0o755)
    # As a part of 'make test', it would tell of its folder too.
    alone = {name: value for name, value in os.environ.items() if not name.startswith('MAKE')}
    done = run(
        'make', '-f', REPOSITORY / 'Makefile', '--eval', f'long: ; @$(BEAT); /bin/sleep 1; {end}',
        'long', f'VENV={tmp_path}', cwd=tmp_path,
        env={**alone, 'PATH': f'{tmp_path}:{os.environ["PATH"]}'},
    )
    assert done.returncode == code
    assert 'Killed' in done.stderr if code else done.stderr == ''
    lines = done.stdout.splitlines()
    assert len(lines) >= 2
    pattern = rf'make: still installing; \S+ in {tmp_path} so far'
    assert [line for line in lines if not re.fullmatch(pattern, line)] == []


def test_given_the_source_when_its_imports_are_listed_then_all_are_declared() -> None:
    distributions = metadata.packages_distributions()
    declared = {canonicalize_name(requirement.name) for requirement in requirements()}
    of_ros = set(ROS_NAME.findall((REPOSITORY / 'package.xml').read_text()))
    imported = imported_packages()
    assert len(imported) > 10
    undeclared = {
        name
        for name in imported - of_ros
        if not declared & {canonicalize_name(d) for d in distributions.get(name, ())}
    }
    assert undeclared == set()


def test_given_the_versions_when_compared_then_package_and_manifest_agree() -> None:
    manifest = (REPOSITORY / 'package.xml').read_text()
    assert f'<version>{taxinet_ros.__version__}</version>' in manifest
    assert metadata.version('taxinet_ros') == taxinet_ros.__version__


def test_given_the_source_tree_when_listed_then_every_folder_is_a_package() -> None:
    folders = {path.parent for path in (REPOSITORY / 'taxinet_ros').rglob('*.py')}
    assert len(folders) > 5
    assert [folder for folder in folders if not (folder / '__init__.py').exists()] == []


@pytest.mark.parametrize('definition', MESSAGES, ids=lambda path: path.stem)
def test_given_a_message_definition_when_imported_then_it_has_those_fields(
    definition: Path,
) -> None:
    message = getattr(taxinet_msgs.msg, definition.stem)
    assert list(message.get_fields_and_field_types()) == fields_in(definition)


@pytest.mark.parametrize(('laid_down', 'foreign'), [
    ({}, False),
    ({'package.xml': b'<package/>'}, True),
    ({'package.xml': b'<package/>', 'sources.sha256': b'0'}, False),
    ({'package.xml': (TF2_MSGS / 'package.xml').read_bytes()}, False),
], ids=['none', 'genuine', 'ours', 'ours, cut short'])
def test_ros21_given_a_tf2_msgs_that_is_not_ours_then_the_build_leaves_it_alone(
    laid_down: dict[str, bytes], foreign: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / 'msg_defs')
    build_with_wheels = importlib.import_module('build_with_wheels')
    built: list[str] = []
    monkeypatch.setattr(build_with_wheels, 'PREFIX', tmp_path)
    monkeypatch.setattr(build_with_wheels, 'fix_include_paths', lambda: None)
    monkeypatch.setattr(build_with_wheels, 'build', lambda package: built.append(package.name))
    package = build_with_wheels.PACKAGES[1]
    assert (package.name, package.source) == ('tf2_msgs', TF2_MSGS)
    package.share.mkdir(parents=True)
    for name, data in laid_down.items():
        (package.share / name).write_bytes(data)
    build_with_wheels.bring_up_to_date(package)
    assert built == ([] if foreign else ['tf2_msgs'])
    assert package.stamp.exists() is not foreign


def test_given_a_folder_with_an_interface_package_then_it_is_built_after_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / 'msg_defs')
    build_with_wheels = importlib.import_module('build_with_wheels')
    built: list[Any] = []
    monkeypatch.setattr(build_with_wheels, 'bring_up_to_date', built.append)
    folder = tmp_path / 'a checkout'
    folder.mkdir()
    monkeypatch.setattr(sys, 'argv', ['build', str(folder)])
    assert build_with_wheels.main() == 1
    assert 'package.xml' in capsys.readouterr().err
    (folder / 'package.xml').write_text('<package><name>../it</name></package>')
    assert build_with_wheels.main() == 1
    assert "'../it' is no name of a package" in capsys.readouterr().err
    assert built == []
    (folder / 'package.xml').write_text('<package><name> their_msgs </name></package>')
    assert build_with_wheels.main() == 0
    assert [package.name for package in built] == ['taxinet_msgs', 'tf2_msgs', 'their_msgs']
    digest = build_with_wheels.sources_digest(built[-1])
    (folder / 'msg').mkdir()
    (folder / 'msg' / 'It.msg').write_text('bool it')
    assert build_with_wheels.sources_digest(built[-1]) != digest


def test_given_a_folder_without_package_when_messages_are_set_up_then_it_is_named(
    tmp_path: Path,
) -> None:
    with pytest.raises(UsageError, match='no package of ROS 2, without package'):
        setup_messages([tmp_path])


def test_given_the_action_when_imported_then_it_carries_a_scenario() -> None:
    goal = taxinet_msgs.action.RunScenario.Goal
    assert goal.get_fields_and_field_types() == {'scenario': 'taxinet_msgs/Scenario'}


def test_given_the_installation_when_ros2_looks_for_executables_then_all_are_there() -> None:
    folder = PREFIX / 'lib' / 'taxinet_ros'
    found = {path.name for path in folder.iterdir() if os.access(path, os.X_OK)}
    assert found == EXECUTABLES


@pytest.mark.parametrize('name', sorted(EXECUTABLES))
def test_given_an_executable_when_its_module_is_imported_then_it_has_a_main(name: str) -> None:
    wrapper = (PREFIX / 'lib' / 'taxinet_ros' / name).read_text()
    assert wrapper == (REPOSITORY / 'scripts' / name).read_text()
    module, start = {
        'taxinet': ('taxinet_ros.cli.start', 'import main'),
        'live_monitor': (LIVE, f'start_module("{LIVE}")'),
    }.get(name, (f'taxinet_ros.nodes.{name}', f'start_node("{name}")'))
    assert start in wrapper
    assert callable(importlib.import_module(module).main)


def test_given_no_activated_environment_when_an_executable_runs_then_it_finds_its_python(
    tmp_path: Path,
) -> None:
    executable = PREFIX / 'lib' / 'taxinet_ros' / 'taxinet'
    done = run(executable, '--help', cwd=tmp_path, env={'PATH': '/usr/bin:/bin'})
    assert done.returncode == 0, done.stderr
    assert 'demo' in done.stdout


def test_given_the_installation_when_shared_files_are_read_then_they_are_the_repository_s() -> None:
    share = PREFIX / 'share' / 'taxinet_ros'
    shipped = shipped_files()
    assert len(shipped) > 3
    differing = [
        path
        for path in shipped
        if (share / path.relative_to(REPOSITORY)).read_bytes() != path.read_bytes()
    ]
    assert differing == []
    assert (PREFIX / 'share/ament_index/resource_index/packages/taxinet_ros').exists()


CPP = {
    'CMakeLists.txt': """
cmake_minimum_required(VERSION 3.16)
project(user)
find_package(taxinet_msgs REQUIRED)
add_executable(user user.cpp)
target_link_libraries(user ${taxinet_msgs_TARGETS})
target_link_options(user PRIVATE -Wl,--allow-shlib-undefined)
""",
    'user.cpp': """
#include <iostream>
#include <taxinet_msgs/msg/tracking_error.hpp>
int main() {
  taxinet_msgs::msg::TrackingError error;
  error.cross_track_error = 1.5;
  std::cout << taxinet_msgs::msg::to_yaml(error);
}
""",
}


def test_given_a_colcon_workspace_when_built_then_ros2_run_launch_and_cpp_find_everything(
    tmp_path: Path,
) -> None:
    bases = ('--build-base', tmp_path / 'build', '--install-base', tmp_path / 'install')
    within = {
        **os.environ,
        'PATH': f'{PREFIX}/bin:{os.environ["PATH"]}',
        'AMENT_PREFIX_PATH': str(PREFIX),
        'CMAKE_PREFIX_PATH': str(PREFIX),
    }
    done = run(
        *(PREFIX / 'bin' / 'colcon', '--log-base', tmp_path / 'log'),
        *('build', '--base-paths', REPOSITORY, REPOSITORY / 'msg_defs', *bases),
        cwd=tmp_path, env=within,
    )
    assert done.returncode == 0, done.stderr
    installed = tmp_path / 'install' / 'taxinet_ros'
    executables = (installed / 'lib' / 'taxinet_ros').iterdir()
    assert {path.name for path in executables if os.access(path, os.X_OK)} == EXECUTABLES
    assert (installed / 'share/taxinet_ros/launch/taxinet.launch.py').exists()
    assert (installed / 'share/ament_index/resource_index/packages/taxinet_ros').exists()
    package = next(installed.glob('lib/python3*/site-packages/taxinet_ros'))
    assert list(package.glob('core/rig/models/*/*.xml'))
    assert (package.parent / 'ros2taxinet.py').exists()

    for name, text in CPP.items():
        (tmp_path / name).write_text(text)
    script = (f'. install/setup.sh && cmake -S . -B user -DPython3_EXECUTABLE={sys.executable} && '
              'cmake --build user && user/user')
    done = run('sh', '-c', script, cwd=tmp_path, env=within)
    assert done.returncode == 0, done.stderr
    assert 'cross_track_error: 1.5' in done.stdout
