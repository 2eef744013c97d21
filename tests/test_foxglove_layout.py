"""The Foxglove layout shows topics and fields that there are, in words that Foxglove knows.

The words are those of the layout types in foxglove-sdk; the app itself is not started.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from taxinet_ros.nodes import interface

layouts = pytest.importorskip('foxglove.layouts')

LAYOUT = Path(__file__).resolve().parent.parent / 'config' / 'foxglove_layout.json'
CONFIGS = {
    '3D': layouts.ThreeDeeConfig,
    'Image': layouts.ImageConfig,
    'Plot': layouts.PlotConfig,
    'RawMessages': layouts.RawMessagesConfig,
}
PATH = re.compile(
    r'(?P<topic>/[\w/]+)(?:\{(?P<filter>\w+)==\$(?P<variable>\w+)\})?(?P<fields>[.\w]*)'
)
OF_THE_APP = {'foxglovePanelTitle', 'title'}
"""Keys that the app gives every panel; the types have them beside the configuration."""


@pytest.fixture(scope='module')
def layout() -> dict[str, Any]:
    return json.loads(LAYOUT.read_text())


def known_words(config: type) -> set[str]:
    """The keys that a typed configuration writes."""
    return set(config()._to_dict())


def panels_in(tree: Any) -> Iterator[str]:
    """Panel ids in the mosaic."""
    if isinstance(tree, str):
        yield tree
        return
    assert tree.keys() == {'direction', 'first', 'second', 'splitPercentage'}
    assert tree['direction'] in ('row', 'column')
    assert 0 < tree['splitPercentage'] < 100
    yield from panels_in(tree['first'])
    yield from panels_in(tree['second'])


def topic_of(name: str) -> interface.Topic:
    """The topic of the table that has this full name."""
    every = (*interface.TOPICS, *interface.TRANSFORMS, *interface.SCENE)
    topics = {'/' + t.name.lstrip('/'): t for t in every}
    return topics[name]


def values_in(layout: dict[str, Any]) -> list[str]:
    """Every message path that is plotted or shown."""
    paths = []
    for config in layout['configById'].values():
        paths += [series['value'] for series in config.get('paths', ())]
        paths += [config['topicPath']] if 'topicPath' in config else []
    return paths


def test_given_the_layout_then_every_panel_is_shown_once_and_configured(layout):
    assert layout.keys() == {
        'configById', 'globalVariables', 'userNodes', 'playbackConfig', 'layout'
    }
    shown = list(panels_in(layout['layout']))
    assert len(shown) >= 7
    assert sorted(shown) == sorted(layout['configById'])


def test_given_the_layout_then_foxglove_knows_every_word_in_it(layout):
    for panel, config in layout['configById'].items():
        assert config.keys() - OF_THE_APP <= known_words(CONFIGS[panel.split('!')[0]]), panel
        for series in config.get('paths', ()):
            assert series.keys() <= known_words(layouts.PlotSeries)
        if 'cameraState' in config:
            assert config['cameraState'].keys() <= known_words(layouts.ThreeDeeCameraState)
            assert config['scene'].keys() <= known_words(layouts.BaseRendererSceneSettings)
        if 'imageMode' in config:
            assert config['imageMode'].keys() <= known_words(layouts.ImageModeConfig)


def test_given_the_layout_then_what_it_shows_is_on_a_topic(layout):
    paths = values_in(layout)
    assert len(paths) >= 8
    for path in paths:
        match = PATH.fullmatch(path)
        assert match, path
        kind: Any = topic_of(match['topic']).type
        fields = kind.get_fields_and_field_types()
        for name in filter(None, match['fields'].split('.')):
            assert fields[name] == 'double', path
        if match['filter']:
            assert fields[match['filter']] == 'string'
            assert match['variable'] in layout['globalVariables']


def test_given_the_layout_then_camera_and_scene_are_in_it(layout):
    image = layout['configById']['Image!camera']['imageMode']
    assert topic_of(image['imageTopic']) is interface.IMAGE
    assert topic_of(image['calibrationTopic']) is interface.CAMERA_INFO
    scene = layout['configById']['3D!scene']
    drawn = (*interface.TRANSFORMS, *interface.SCENE)
    assert {topic_of(name).name for name in scene['topics']} >= {t.name for t in drawn}
    assert (scene['followTf'], scene['fixedFrame']) == (interface.BASE_FRAME, interface.MAP_FRAME)
