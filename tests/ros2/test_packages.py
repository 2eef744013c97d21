"""Manifests, change logs and settings that ROS 2's tools read; taxinet_msgs is a package alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
import yaml
from catkin_pkg.changelog import get_changelog_from_path
from catkin_pkg.package import parse_package
from catkin_pkg.packages import find_packages

ROOT = Path(__file__).parents[2]
MSGS = ROOT / 'msg_defs'
FOLDERS = [ROOT, MSGS, ROOT / 'examples' / 'own_perception_cpp']


@pytest.mark.parametrize('folder', FOLDERS, ids=lambda folder: folder.name)
def test_given_a_manifest_then_it_is_valid_without_a_warning(folder):
    warnings: list[str] = []
    package = parse_package(folder, warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []


def test_given_the_manifests_then_they_agree_on_who_and_where():
    ours, theirs = (parse_package(folder) for folder in (ROOT, MSGS))
    assert ours.version == theirs.version
    assert ours.licenses == theirs.licenses == ['Apache-2.0']
    assert [str(one) for one in ours.maintainers] == [str(one) for one in theirs.maintainers]
    urls = [{(url.type, url.url) for url in package.urls} for package in (ours, theirs)]
    assert urls[0] == urls[1] != set()


@pytest.mark.filterwarnings('ignore:nodes.Node.traverse:DeprecationWarning')  # catkin_pkg's
@pytest.mark.parametrize('folder', FOLDERS[:2], ids=lambda folder: folder.name)
def test_given_a_change_log_then_catkin_reads_it_and_it_has_the_version(folder):
    package = parse_package(folder)
    log = get_changelog_from_path(folder / 'CHANGELOG.rst', package.name)
    assert log.get_content_of_version(package.version)


def test_given_the_folder_of_taxinet_msgs_then_it_is_one_whole_package_alone(tmp_path):
    alone = tmp_path / 'taxinet_msgs'
    shutil.copytree(MSGS, alone)
    assert [package.name for package in find_packages(tmp_path).values()] == ['taxinet_msgs']
    assert (alone / 'LICENSE').read_text() == (ROOT / 'LICENSE').read_text()
    readme, build = ((alone / name).read_text() for name in ('README.md', 'CMakeLists.txt'))
    interfaces = [*alone.glob('msg/*.msg'), *alone.glob('action/*.action')]
    assert len(interfaces) > 5
    for path in interfaces:
        assert f'`{path.stem}`' in readme
        assert f'"{path.relative_to(alone)}"' in build


def test_given_the_settings_of_colcon_and_rosdoc2_then_what_they_name_is_there():
    (tests,) = yaml.safe_load((ROOT / 'colcon.pkg').read_text())['pytest-args']
    assert ROOT / tests == Path(__file__).parent
    header, settings = yaml.safe_load_all((ROOT / 'rosdoc2.yaml').read_text())
    assert header == {'type': 'rosdoc2 config', 'version': 1}
    (builder,) = settings['builders']
    assert (ROOT / builder['sphinx']['user_doc_dir'] / 'index.md').is_file()
    (named,) = (one for one in parse_package(ROOT).exports if one.tagname == 'rosdoc2')
    assert named.content == 'rosdoc2.yaml'
