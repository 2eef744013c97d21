"""What a network was trained in: camera, places, aircraft, weather and hours of its pictures.

A domain has a list of words, or the least and the greatest number, by scenario key. Of a network
for any place or camera it has their numbers, such as the width of the runway, instead of their
names, and the sun's elevation, as the hours say little about the light of any place. It is in a
network's card, or under ``domain`` in the description of an ONNX network. Scenes outside it are
named before they are run, and where runs are analysed; an unknown domain names none.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.core.rig.catalogue import CAMERAS
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    BY_KEY,
    CAMERA,
    CAMERA_OFFSETS,
    CATALOGUES,
    DATE,
    PLACE,
    RAIN,
    SKY,
    TIME_OF_DAY,
    TRACK,
)
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, expected

Domain = Mapping[str, tuple[Any, ...]]

WIDTH = 'runway_width_m'
SUN = 'sun_elevation_deg'
_NUMBERS: Mapping[str, tuple[str, str, str, Callable[[Any], float]]] = {
    WIDTH: (PLACE.key, 'runway width', 'm', lambda place: place.runway.width_m),
    'camera_aside_m': (CAMERA.key, 'camera aside', 'm', lambda one: abs(one.offset_m[1])),
    'camera_turned_deg': (
        CAMERA.key, 'camera turned aside', '°', lambda one: abs(math.degrees(one.yaw_rad))),
    'camera_down_deg': (
        CAMERA.key, 'camera turned down', '°', lambda one: math.degrees(one.pitch_rad)),
    'camera_field_of_view_deg': (
        CAMERA.key, 'field of view', '°',
        lambda one: 2 * math.degrees(math.atan(one.width_px / 2 / one.focal_px[0]))),
}
"""What describes a document in numbers: key of the document, title, unit, and function of it."""
_WORDS = tuple(field.key for field in (CAMERA, PLACE, AIRCRAFT_MODEL, TRACK, SKY))
_OFFSETS = {field.key: (0.0, 0.0) for field in CAMERA_OFFSETS}
_STEPS = {
    TIME_OF_DAY.key: 0.5, SUN: 1.0, RAIN.key: 5.0,
    **{key: 0.5 if unit == '°' else 0.01 for key, (_, _, unit, _) in _NUMBERS.items()},
    **{field.key: 0.05 if field.unit == 'm' else 0.5 for field in CAMERA_OFFSETS},
}
"""Numbers, and to what their ends are rounded outwards: what is drawn does not reach the ends."""
DOMAIN_KEYS = (*_WORDS, *_STEPS)


def domain_of_scenes(
    scenes: Iterable[Mapping[str, Any]], *, rounded: bool = True, unnamed: Collection[str] = ()
) -> Domain:
    """The domain of the pictures of scenes.

    Args:
        scenes: values by key in human units, as :meth:`.Scenario.to_human`; ones that are missing
            or empty are left out.
        rounded: whether the ends of ranges are rounded outwards.
        unnamed: keys of documents that are described by numbers instead of their names.
    """
    seen: dict[str, set[Any]] = {key: set() for key in DOMAIN_KEYS}
    moments: set[tuple[Any, ...]] = set()
    anywhere = PLACE.key in unnamed
    for scene in scenes:
        for key in DOMAIN_KEYS:
            value = scene.get(key)
            if isinstance(value, str | float) and value == value and value != '':
                seen[key].add(value)
        if anywhere:
            moments.add(tuple(scene.get(key) for key in (PLACE.key, DATE.key, TIME_OF_DAY.key)))
    seen[SUN] = set(_elevations(moments))
    for key, (document, _, _, number) in _NUMBERS.items():
        if key == WIDTH or document in unnamed:
            seen[key] |= {number(one) for one in _documents(document, seen[document])}
    seen[CAMERA.key] = {_camera_word(word) for word in seen[CAMERA.key]}
    for key, step in _STEPS.items() if rounded else ():
        ends = [round(value / step, 6) for value in seen[key]]
        seen[key] = {round(end(one) * step, 6) for one in ends for end in (math.floor, math.ceil)}
    return {
        key: _spread(key, values) for key, values in seen.items()
        if values and key not in unnamed and (key not in _OFFSETS or any(values))
    }


def _elevations(moments: Iterable[tuple[Any, ...]]) -> Iterator[float]:
    """Elevation of the sun [deg] at places, dates and hours that are known."""
    for word, date, hour in moments:
        for place in _documents(PLACE.key, (word,) if word and date and hour is not None else ()):
            yield math.degrees(sun_position(date, 3600 * hour, place.runway)[1])


def _spread(key: str, values: Iterable[Any]) -> tuple[Any, ...]:
    found = sorted(set(values))
    return tuple(found) if key in _WORDS else (found[0], found[-1])


def _camera_word(word: str) -> str:
    """The shipped camera that makes the same pictures, if there is one."""
    with contextlib.suppress(UsageError):  # of a campaign that has not been read
        look = CAMERAS.typed(word).look
        return next((name for name in CAMERAS.shipped if CAMERAS.find(name).look == look), word)
    return word


def _documents(key: str, words: Iterable[str]) -> Iterator[Any]:
    for word in words:
        with contextlib.suppress(UsageError):  # of a campaign that has not been read
            yield CATALOGUES[key].typed(word)


def joined_domains(domains: Sequence[Domain | None]) -> Domain | None:
    """The domain of all pictures together; None if one is unknown.

    What one describes in numbers, such as places, all do; the sun's elevation is of those that
    have it, as one with named places does not say.
    """
    known = [{**_OFFSETS, **domain} for domain in domains if domain is not None]
    if not known or len(known) < len(domains):
        return None
    unnamed = {key for key, *_ in _NUMBERS.values() if any(key not in one for one in known)}
    known = [_in_numbers(domain, unnamed) for domain in known]
    keys = [
        key for key in DOMAIN_KEYS if (any if key == SUN else all)(key in one for one in known)]
    joined = {
        key: _spread(key, (one for domain in known for one in domain.get(key, ())))
        for key in keys
    }
    return {key: values for key, values in joined.items() if values != _OFFSETS.get(key)}


def _in_numbers(domain: Domain, unnamed: Collection[str]) -> dict[str, tuple[Any, ...]]:
    """A domain without the names of these documents, but with what they are in numbers."""
    found = {key: values for key, values in domain.items() if key not in unnamed}
    for key, (document, _, _, number) in _NUMBERS.items():
        if document in unnamed and document in domain:
            numbers = [number(one) for one in _documents(document, domain[document])]
            found |= {key: _spread(key, numbers)} if numbers else {}
    return found


def domain_doubts(
    network: str, domain: Domain | None, scenes: Sequence[Mapping[str, Any]]
) -> list[str]:
    """A warning if scenes are outside what a network was trained in.

    Args:
        network: its name, for the line.
        domain: its domain; None if unknown.
        scenes: as for :func:`domain_of_scenes`.
    """
    if domain is None or not scenes:
        return []
    trained, here, beyond = _compared(domain, scenes)
    if not beyond:
        return []
    verb = 'this scene has' if len(scenes) == 1 else 'scenes here have'
    return [
        f'{network} was trained with {domain_words(trained, beyond)}; {verb} '
        f'{domain_words({**here, **beyond}, beyond)}'
    ]


def _compared(
    domain: Domain, scenes: Sequence[Mapping[str, Any]]
) -> tuple[Domain, Domain, Domain]:
    """A domain with all its keys, that of scenes, and what of theirs is outside it."""
    trained = {**_OFFSETS, **domain}
    # What is named is told by its name alone.
    unnamed = {document for document, *_ in _NUMBERS.values() if document not in trained}
    here = {**_OFFSETS, **domain_of_scenes(scenes, rounded=False, unnamed=unnamed)}
    return trained, here, {
        key: tuple(one for one in here[key] if key in _STEPS or one not in trained[key])
        for key in DOMAIN_KEYS
        if key in trained and key in here and not (key == WIDTH and PLACE.key in trained)
        and _spread(key, (*trained[key], *here[key])) != _spread(key, trained[key])
    }


def usual_conditions(
    domain: Domain | None, scenes: Sequence[Mapping[str, Any]], usual: Mapping[str, Any]
) -> dict[str, Any]:
    """Sky, rain and hour that take scenes into a domain, by key; of what is in it, nothing.

    Args:
        domain: of a network; None if unknown.
        scenes: as for :func:`domain_of_scenes`.
        usual: values by key that are taken where the domain has them, else the first or the middle.
    """
    if domain is None or not scenes:
        return {}
    trained, _, beyond = _compared(domain, scenes)
    found: dict[str, Any] = {}
    for key in (SKY.key, RAIN.key, TIME_OF_DAY.key):
        values, value = trained.get(key, ()), usual[key]
        if key not in beyond:
            continue
        if key in _WORDS:
            found[key] = value if value in values else values[0]
        else:
            found[key] = value if values[0] <= value <= values[-1] else sum(values) / 2
    return found


def domain_words(domain: Domain | None, keys: Iterable[str] = DOMAIN_KEYS) -> str:
    """Display text: ``camera wing, place kmwh_04 (30.5 m wide), time of day 06:00 to 18:00``."""
    if domain is None:
        return 'unknown'
    said = [key for key in keys if key in domain and not (key == WIDTH and PLACE.key in domain)]
    return ', '.join(dict.fromkeys(_part_words(key, domain) for key in said))


def _part_words(key: str, domain: Domain) -> str:
    if key in _NUMBERS or key == SUN:
        title, unit = _NUMBERS[key][1:3] if key in _NUMBERS else ('sun', '° high')
        ends = ' to '.join(dict.fromkeys(f'{end:.3g}' for end in domain[key]))
        return f'{title} {ends}{unit}' if unit.startswith('°') else f'{title} {ends} {unit}'
    field = BY_KEY[key]
    if field.key in _WORDS:
        text = f'{field.label} {", ".join(domain[field.key])}'
    elif domain[field.key] == _OFFSETS.get(field.key):
        return 'the camera in its place'
    else:
        name = field.title if field.key in _OFFSETS else field.label
        text = f'{name} {" to ".join(dict.fromkeys(map(field.value_words, domain[field.key])))}'
    if field is PLACE and WIDTH in domain:
        text += f' ({" to ".join(dict.fromkeys(f"{end:.3g}" for end in domain[WIDTH]))} m wide)'
    return text


def read_domain(top: Section) -> Domain | None:
    """Read the optional key ``domain`` of a card or description.

    Raises:
        UsageError: an unknown key or a bad value.
    """
    if 'domain' not in top or top.take('domain', 'a domain') is None:
        return None
    given = top.section('domain', DOMAIN_KEYS)
    found: dict[str, tuple[Any, ...]] = {}
    for key in given:
        words = given.take(key, 'a list of words')
        if key in _STEPS:
            found[key] = given.numbers(key, 2, -1e6, 1e6)
        elif isinstance(words, list) and words and all(isinstance(one, str) for one in words):
            found[key] = tuple(words)
        else:
            raise given.wrong(expected('a list of words', words), key)
    return found
