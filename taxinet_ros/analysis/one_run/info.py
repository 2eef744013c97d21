"""What a bag contains: its runs, scenes, outcomes and topics, as lines and as JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.bag.layout import storage_files
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.run.facts import RunFacts, free_account, made_on
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.bag.writer import FORK_METADATA, RUN_METADATA
from taxinet_ros.core.fork import fork_of_text
from taxinet_ros.core.motion.controller import is_steering_law
from taxinet_ros.core.pacing.free_run import free_run_line
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE
from taxinet_ros.core.provenance import words as stack_words
from taxinet_ros.core.rig.catalogue import DEFAULT_CAMERA
from taxinet_ros.core.scenario_fields import BY_KEY, along_words, clock_words, unusual_words
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import KMWH

_TEXT = Path(__file__).with_suffix('.j2')
_LONGEST_S = 86_400
"""Longest plausible recording [s]."""


def info_text(recording: Recording, runs: Mapping[str, RunFacts | None]) -> str:
    """What the command prints.

    Args:
        recording: the bag.
        runs: facts of its runs by their words; '' for the only one of the recorder node.
    """
    info = recording.info
    texts = [_run_text(info, words, facts) for words, facts in runs.items()]
    return '\n'.join([*texts, macro_text(
        _TEXT, 'bag', info=info, files=storage_files(info.path),
        foreign=bool(recording.runs) and not recording.plain, ours=any(runs.values()),
        back_s=info.back_ns / NS_PER_S, longest_s=_LONGEST_S,
    )])


def _run_text(info: BagInfo, words: str, facts: RunFacts | None) -> str:
    more: dict[str, Any] = {}
    if facts is not None:
        law, fork = facts.nodes.get('steering_controller'), info.metadata.get(
            FORK_METADATA, {}).get('fork')
        account = None if words else free_account(info)
        more = {
            'scene': scene_words(facts.scene),
            'law': law is not None and is_steering_law(law.implementation),
            'fork': fork and _fork_words(fork, facts),
            'free': account and free_run_line(account.figures()),
            'made_on': stack_words(made_on(info)), 'world': KMWH,
            'version': info.metadata.get(RUN_METADATA, {}).get('taxinet_ros_version', 'unknown'),
        }
    return macro_text(_TEXT, 'run', words=words, facts=facts, **more)


def _fork_words(text: str, facts: RunFacts) -> str:
    """What a forked run was forked from, and what changed then."""
    try:
        fork = fork_of_text(text)
    except UsageError as error:
        return str(error)
    changes = [
        f'{BY_KEY[key].label} {BY_KEY[key].value_words(before)} -> {BY_KEY[key].value_words(now)}'
        for key, (before, now) in fork.changes(facts.scene).items()
    ]
    eyes = facts.nodes.get('perception')
    if eyes is not None and eyes.implementation != fork.perception:
        changes.append(f'perception {fork.perception} -> {eyes.implementation}')
    if fork.placed is not None:
        changes.append(f'placed at {fork.placed.x_m:.1f} m, {fork.placed.y_m:+.2f} m in map')
    return f'of {fork.run_id} at {fork.at_s:g} s: {", ".join(changes) or "scene as before"}'


def scene_words(scene: Mapping[str, Any]) -> str:
    """One-line description of a scenario in display units."""
    rain = f', rain {scene["rain_percent"]:.0f} %' if scene['rain_percent'] else ''
    camera = '' if scene['camera'] == DEFAULT_CAMERA else f', camera {scene["camera"]}'
    place = '' if scene['place'] == DEFAULT_PLACE else f'{scene["place"]}, '
    return (
        f'{place}CTE {scene["cross_track_m"]:+.2f} m (left positive), '
        f'HE {scene["heading_deg"]:+.1f} deg, '
        f'{scene["distance_m"]:.0f} m {along_words(scene["track"])}, {scene["date"]} '
        f'{clock_words(scene["time_of_day_h"])}, {scene["clouds"]}{rain}, '
        f'shadows {"on" if scene["shadows"] else "off"}, '
        f'{"" if scene["crossing"] else "no crossing, "}{scene["aircraft"]}{camera}, '
        f'{scene["duration_s"]:g} s{unusual_words(scene)}'
    )


def info_json(
    info: BagInfo, recording: Recording, runs: Sequence[RunFacts | None]
) -> dict[str, Any]:
    """Everything as plain values.

    Args:
        info: of the bag.
        recording: the same bag.
        runs: facts of its runs.
    """
    only = runs[0] if len(runs) == 1 else None
    return {
        'bag': str(info.path), 'whole': info.complete, 'trouble': info.trouble,
        'unchecked': info.unchecked, 'stamps_go_back_ns': info.back_ns,
        'run': None if only is None else _facts_json(only),
        'runs': [_facts_json(facts) for facts in runs if facts is not None],
        'own_recorder': recording.plain,
        'files': [
            {'name': file.name, 'bytes': file.stat().st_size} for file in storage_files(info.path)
        ],
        'start_ns': info.start_ns, 'end_ns': info.end_ns,
        'messages': sum(info.counts.values()),
        'topics': [
            {'name': topic.name, 'type': topic.type, 'messages': info.counts[topic.name],
             'type_hash': topic.type_hash}
            for topic in info.topics
        ],
        'attachments': list(info.attachments),
        'metadata': {name: words for name, words in info.metadata.items() if name != 'rosbag2'},
    }


def _facts_json(facts: RunFacts) -> dict[str, Any]:
    """Facts of a run as JSON; an interval as ``lower`` and ``upper``."""
    values = asdict(facts)
    values['judged'] = {
        name: {
            'formula': one.formula, 'lower': one.interval.lower, 'upper': one.interval.upper,
            'final': one.final,
        }
        for name, one in facts.judged.items()
    }
    plain: dict[str, Any] = _finite(values)
    return plain


def _finite(value: Any) -> Any:
    """``value`` with non-finite numbers as text: ``inf``, ``-inf``, ``nan``."""
    if isinstance(value, Mapping):
        return {key: _finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
