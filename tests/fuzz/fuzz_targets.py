"""What reads files from elsewhere, with sound examples of each kind to make mutants of.

The examples are made by the tests, or shipped; nothing foreign is among them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import falsify_samples
import network_samples
import onnx_samples
import whole_runs
import yaml

from taxinet_ros.analysis.campaign.folder import SCHEMA, check_folder
from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.description import read_description
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bench.report import load_report
from taxinet_ros.core.perception.onnx.sidecar import parse_sidecar
from taxinet_ros.core.perception.weights import SHIPPED, card_path, load_model
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.files.sealed_json import sealed_text
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.scenes.programs import find_program, shipped_folder
from taxinet_ros.scenes.source import program_text
from taxinet_ros.trials.experiment import known_experiments, read_experiment
from taxinet_ros.trials.learned_result import LEARNED_NAME, LearnedResult
from taxinet_ros.trials.record.book import finished_row, run_request
from taxinet_ros.trials.record.content import (
    BEGUN,
    REQUIREMENT,
    ROW,
    read_campaign,
    run_key,
)
from taxinet_ros.trials.record.facts import FACTS, campaign_facts
from taxinet_ros.trials.record.resumption import (
    check_same_campaign,
    unfinished_search,
)
from taxinet_ros.trials.record.table import table
from taxinet_ros.trials.requirements import read_specs

Use = Callable[[bytes], object]


@dataclass(frozen=True)
class Target:
    """A reader: how sound examples and a function that reads bytes are made in a folder."""

    text: bool
    examples: Callable[[Path], list[bytes]]
    reader: Callable[[Path], Use]


def _weights(folder: Path) -> Use:
    """Weights whose card has their checksum, so that nonsense gets beyond it."""
    card = json.loads(card_path(network_samples.save_sample(folder)).read_text())
    path = folder / 'net.safetensors'

    def use(data: bytes) -> object:
        path.write_bytes(data)
        card_path(path).write_text(
            json.dumps({**card, 'weights_sha256': network_samples.digest(data)})
        )
        return load_model(path)
    return use


def _card(folder: Path) -> Use:
    path = network_samples.save_sample(folder)
    return lambda data: (card_path(path).write_bytes(data), load_model(path))


def _description(folder: Path) -> Use:
    """``metadata.yaml`` of a sound bag."""
    run = whole_runs.write_run(folder / 'run', _few()).parent

    def use(data: bytes) -> object:
        (run / METADATA_FILE).write_bytes(data)
        read_info(run)
        check_bag(run)
        return read_description(run)
    return use


def _few() -> list[Any]:
    messages = whole_runs.run_messages()
    return [m for m in messages if m[0] != '/camera/image_raw' and m[1] <= 200_000_000]


def _file(name: str, read: Callable[[Path], object]) -> Callable[[Path], Use]:
    def reader(folder: Path) -> Use:
        path = folder / name
        return lambda data: (path.write_bytes(data), read(path))
    return reader


def _entries(folder: Path) -> bytes:
    """Entries of a record as one text, without digests, so that nonsense gets beyond them."""
    options = falsify_samples.options(folder).campaign
    rows = {}
    for index in range(4):
        scenario = Scenario(cross_track_m=float(index), duration_s=1.0)
        request = run_request(options, index, scenario, ('perception',))
        outcome = Outcome.INFRA_ERROR if index == 3 else None
        result = falsify_samples.result(request, outcome)
        rows[run_key(index)] = finished_row(options, request, result).with_choice(
            sampler='ce', point={'x': 0.5}, weight=1.0, retries=0
        ).to_json()
    return json.dumps({
        FACTS: {'': _search_facts(folder)}, ROW: rows, BEGUN: dict.fromkeys(rows, 1),
        REQUIREMENT: {'on_runway': {
            'formula': 'always(abs(cte) <= 15)', 'intervals': {run_key(0): (1.0, 1.0)},
        }},
    }).encode()


def _search_facts(folder: Path) -> dict[str, Any]:
    options = falsify_samples.options(folder).campaign
    facts = campaign_facts(options, find_program('nominal'), program_text('nominal'))
    return {**facts, 'sampler': 'ce'}


def _resume(folder: Path) -> Use:
    """What a resumed search does with the entries of a record, and an analysis."""
    facts = _search_facts(folder)

    def use(data: bytes) -> object:
        (folder / RECORD_NAME).unlink(missing_ok=True)
        values = _object(data) or {}
        with Record(folder / RECORD_NAME) as record:
            record.put_all([
                (kind, key, value) for kind, entries in values.items() if isinstance(entries, dict)
                for key, value in entries.items()
            ])
        content = read_campaign(folder)
        check_same_campaign(folder, content, facts)
        unfinished_search(content, LAG)
        return table(content.rows, ['phi_eventually'])
    return use


def _record(folder: Path) -> bytes:
    place = folder / 'example'
    _resume(place)(_entries(place))
    return (place / RECORD_NAME).read_bytes()


def _sealed(name: str, read: Callable[[Path], object]) -> Callable[[Path], Use]:
    """Read a sealed file whose checksum fits, so that nonsense gets beyond it."""
    def resealed(data: bytes) -> bytes:
        values = _object(data)
        return data if values is None else sealed_text(values).encode()

    def reader(folder: Path) -> Use:
        path = folder / name
        return lambda data: (path.write_bytes(resealed(data)), read(path))
    return reader


def _object(data: bytes) -> dict[str, Any] | None:
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return values if isinstance(values, dict) else None


_LEARNED = LearnedResult(
    facts={'program': 'nominal', 'seed': 1, 'sampler': 'ce'},
    choices=falsify_samples.SPACE.choices,
    probabilities={'x': (0.25, 0.75), 'y': (0.5, 0.5)},
)
_REPORT = {'machine': {'cores': 2}, 'figures': {'loop/truth': {'median_s': 0.1, 'q1_s': 0.1}}}
_SPECS = b"""predicates:
  on_centreline: abs(cte) <= 1.5
specs:
  reach: 'F[0, 10] G on_centreline'
  gentle: 'always[10 s:inf](abs(steering) <= 3 deg)'
"""


def _unsealed(text: str) -> Callable[[Path], list[bytes]]:
    """The values of a sealed file."""
    values = json.loads(text)
    return _jsons({name: values[name] for name in values if name not in ('seal', 'checksum')})


def _jsons(*values: object) -> Callable[[Path], list[bytes]]:
    return lambda folder: [json.dumps(value, indent=1).encode() for value in values]


TARGETS: dict[str, Target] = {
    'weights': Target(
        False, lambda folder: [network_samples.save_sample(folder).read_bytes()[:6000],
                               network_samples.save_sample(folder).read_bytes()], _weights),
    'model card': Target(True, lambda folder: [
        card_path(network_samples.save_sample(folder)).read_bytes(),
        card_path(SHIPPED['taxinet']).read_bytes(),
    ], _card),
    'metadata.yaml': Target(True, lambda folder: [
        (whole_runs.write_run(folder / 'example', _few()).parent / METADATA_FILE).read_bytes()
    ], _description),
    'onnx description': Target(True, lambda folder: [
        yaml.safe_dump(onnx_samples.described()).encode(),
        yaml.safe_dump(onnx_samples.described(onnx_samples.our_scaling())).encode(),
    ], lambda folder: lambda data: parse_sidecar(folder / 'net.yaml', data)),
    'spec file': Target(True, lambda folder: [_SPECS],
                        _file('specs.yaml', lambda path: read_specs([str(path)]))),
    'experiment': Target(True, lambda folder: [
        (shipped_folder() / 'experiments' / f'{name}.yaml').read_bytes()
        for name in known_experiments()
    ], _file('mine.yaml', read_experiment)),
    'entries of a record': Target(True, lambda folder: [_entries(folder)], _resume),
    'record': Target(False, lambda folder: [_record(folder)],
                     _file(RECORD_NAME, lambda path: read_campaign(path.parent))),
    'learned.json': Target(True, _unsealed(_LEARNED.to_json()),
                           _sealed(LEARNED_NAME, lambda path: LearnedResult.read(path.parent))),
    'bench report': Target(True, _jsons(_REPORT), _file('old.json', load_report)),
    'analysis.json': Target(
        True, _jsons({'schema': SCHEMA, 'version': 1, 'files': ['analysis.json']}),
        _sealed('analysis.json', lambda path: check_folder(path.parent))),
}
