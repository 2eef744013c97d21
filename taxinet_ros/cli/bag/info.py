"""``taxinet bag info``: show the contents of a bag as text or JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.cli.options import BagArgument, JsonOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.reader import BagInfo
    from taxinet_ros.bag.run.facts import NodeFacts, RunFacts
    from taxinet_ros.bag.run.recording import Recording

_LABEL_WIDTH = 11
_LONGEST_S = 86_400
"""Longest plausible recording [s]."""


def info(bag: BagArgument, as_json: JsonOption = False) -> int:
    """Show the contents of a bag: run, scene, outcome, robustness, topics."""
    from taxinet_ros.cli.bag.input import exit_code_of

    return exit_code_of(bag, lambda: _show(bag, as_json))


def _show(bag: Path, as_json: bool) -> int:
    from taxinet_ros.bag.run.recording import open_recording

    recording = open_recording(bag)
    info = recording.info
    if recording.plain or not recording.runs:
        runs = {'': recording.facts}
    else:
        runs = {run.words(): one.facts for run, one in zip(recording.runs, recording, strict=True)}
    if as_json:
        print(json.dumps(_plain(info, recording, list(runs.values())), indent=2))
    else:
        lines = [line for words, facts in runs.items() for line in _run_lines(info, words, facts)]
        console = line_console()
        for label, text in [*lines, *_bag_lines(info, recording)]:
            console.print(f'{label:<{_LABEL_WIDTH}}{text}')
    return ExitCode.OK if info.complete else ExitCode.INCOMPLETE


def _run_lines(
    info: BagInfo, words: str, facts: RunFacts | None
) -> Iterator[tuple[str, str]]:
    from taxinet_ros.bag.run.facts import free_account, made_on
    from taxinet_ros.bag.writer import FORK_METADATA, RUN_METADATA
    from taxinet_ros.core.pacing.free_run import free_run_line
    from taxinet_ros.core.provenance import words as stack_words

    if facts is None:
        why = 'there is no scenario in it'
        yield 'run', f'{words}: {why}' if words else f'not from taxinet_ros: {why}'
        return
    version = info.metadata.get(RUN_METADATA, {}).get('taxinet_ros_version', 'unknown')
    drawn = f'{facts.program}, seed {facts.seed}, index {facts.index}' if facts.program else 'alone'
    by = '' if words else f', recorded by taxinet_ros {version}'
    yield 'run', f'{words or facts.run_id} ({drawn}){by}'
    yield 'outcome', _outcome(facts)
    for name, judged in facts.judged.items():
        yield '', f'{name}: {judged.interval.words()}, of {judged.formula}'
    yield 'scene', scene_words(facts.scene)
    yield from _node_lines(facts.nodes)
    if fork := info.metadata.get(FORK_METADATA, {}).get('fork'):
        yield 'fork', _fork_words(fork, facts)
    world = facts.nodes.get('simulator')
    if world is not None and world.implementation:
        yield 'timing', world.implementation
        account = free_account(info)
        if account is not None and not words:
            yield '', free_run_line(account.figures())
    if facts.figures:
        yield 'figures', ', '.join(_figures(facts.figures))
    if not words:
        yield 'made on', stack_words(made_on(info)) or 'not told'


def _fork_words(text: str, facts: RunFacts) -> str:
    """What a forked run was forked from, and what changed then."""
    from taxinet_ros.core.fork import fork_of_text
    from taxinet_ros.core.scenario_fields import BY_KEY

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


def _node_lines(nodes: Mapping[str, NodeFacts]) -> Iterator[tuple[str, str]]:
    """Lines on perception, controller and world of a run."""
    from taxinet_ros.core.motion.controller import is_steering_law
    from taxinet_ros.registry import KMWH

    perception, law = nodes.get('perception'), nodes.get('steering_controller')
    if perception is not None:
        yield 'perception', _who(perception)
    if law is not None and is_steering_law(law.implementation):
        yield 'gains', law.implementation or 'as shipped'
    elif law is not None:
        yield 'controller', _who(law)
    world = nodes.get('simulator')
    if world is not None and world.origin:
        yield 'world', _who(world)
    elif nodes:  # the shipped world reports nothing
        yield 'world', KMWH


def _who(node: NodeFacts) -> str:
    hashed = f', {"sha256" if node.origin else "weights"} {node.fingerprint}'
    who = node.origin or node.implementation or 'unnamed'
    return who + (hashed if node.fingerprint else '')


def _bag_lines(info: BagInfo, recording: Recording) -> Iterator[tuple[str, str]]:
    from taxinet_ros.bag.layout import storage_files
    from taxinet_ros.core.types import NS_PER_S

    yield 'bag', 'whole' if info.complete else f'NOT WHOLE: {info.trouble}'
    if not info.complete:
        yield '', f'taxinet bag recover {info.path} --out NEW'
    if info.unchecked:
        yield '', info.unchecked
    for number, file in enumerate(storage_files(info.path)):
        yield ('' if number else 'files'), f'{file.name}  {file.stat().st_size / 1e6:.1f} MB'
    start, end = info.start_ns / 1e9, info.end_ns / 1e9
    clock = 'simulated' if recording.plain or not recording.runs else "by the recorder's clock"
    yield 'time', f'{info.duration_s:.1f} s {clock}, from {start:.1f} to {end:.1f} s'
    if info.duration_s > _LONGEST_S:
        yield '', 'more than a day: some stamps must be wrong'
    if info.back_ns >= NS_PER_S:
        yield '', f'stamps go back by up to {info.back_ns / NS_PER_S:g} s'
    if recording.runs and not recording.plain:
        yield '', f'a bag of each run: taxinet bag split {info.path} --out DIR'
    yield 'messages', str(sum(info.counts.values()))
    width = max((len(topic.name) for topic in info.topics), default=0)
    for number, topic in enumerate(info.topics):
        label = '' if number else 'topics'
        yield label, f'{topic.name:<{width}} {info.counts[topic.name]:6d}  {topic.type}'
    if info.attachments:
        yield 'attached', ', '.join(info.attachments)


def scene_words(scene: Mapping[str, Any]) -> str:
    """One-line description of a scenario in display units."""
    from taxinet_ros.core.place.catalogue import DEFAULT_PLACE
    from taxinet_ros.core.rig.catalogue import DEFAULT_CAMERA
    from taxinet_ros.core.scenario_fields import along_words, clock_words, unusual_words

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


def _outcome(facts: RunFacts) -> str:
    why = ' '.join(word for word in (facts.kind, facts.who) if word)
    words = facts.outcome or 'unknown: the bag ends before the run does'
    detail = f' ({": ".join(part for part in (why, facts.detail) if part)})' if why else ''
    return f'{words}{detail}, {facts.steps} control steps judged'


_FIGURES = {
    'max_cross_track_error': ('|CTE| at most', 1.0, 'm'),
    'settle_time': ('settled after', 1.0, 's'),
    'estimate_cte_error_mean_abs': ('estimate of CTE off by', 1.0, 'm'),
    'estimate_he_error_mean_abs': ('of HE by', 180 / math.pi, 'deg on average'),
}
"""Words, factor and unit for some fields of a verdict."""


def _figures(figures: Mapping[str, float | bool]) -> Iterator[str]:
    stopped = bool(figures.get('stopped_early'))
    if figures.get('left_runway'):
        yield 'left the runway'
    else:  # where it would have gone is not known
        yield f'stayed on the runway{" until it was stopped" if stopped else ""}'
    if stopped:
        yield 'stopped early'
    for name, (words, factor, unit) in _FIGURES.items():
        value = figures.get(name)
        if value is not None and math.isfinite(value):
            yield f'{words} {value * factor:.2f} {unit}'
    if figures.get('unusable_estimates'):
        yield f'{figures["unusable_estimates"]:.0f} frames without estimate'


def _plain(
    info: BagInfo, recording: Recording, runs: Sequence[RunFacts | None]
) -> dict[str, Any]:
    from taxinet_ros.bag.layout import storage_files

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
    plain: dict[str, Any] = finite(values)
    return plain


def finite(value: Any) -> Any:
    """``value`` with non-finite numbers as text: ``inf``, ``-inf``, ``nan``."""
    if isinstance(value, Mapping):
        return {key: finite(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [finite(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value
