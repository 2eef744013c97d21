"""Verify evidence: every byte, every hash, every figure, and a sample of the runs.

Figures, limits and argument are made again from the inputs by the function that made them first,
and compared value by value. Runs of the sample are driven again without ROS; their robustness and
the messages of their bags have to be equal to the bit.
"""

from __future__ import annotations

import dataclasses
import json
import random
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE, is_free
from taxinet_ros.core.provenance import differences, provenance
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.evidence.evidence import (
    JSON_NAME,
    MANIFEST_NAME,
    SCHEMA,
    Collected,
    Progress,
    collect,
)
from taxinet_ros.extras.evidence.inputs import CampaignInput, requirement_of, usable_network
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.trials.loop_run import Loop
from taxinet_ros.trials.past_runs.shared_scenes import system_of
from taxinet_ros.trials.record.facts import recorded_stacks, recorded_world
from taxinet_ros.trials.record.row import RunRow

_LINE = re.compile(r'([0-9a-f]{64})  ([^/\n]+)')


@dataclass(kw_only=True)
class Verification:
    """What was verified.

    Attributes:
        checked: number of things that hold, by kind.
        damaged: what is damaged, missing or changed, or says something else than its inputs.
        different: runs that came out differently.
        unchecked: what could not be verified, and why.
        notes: remarks that are no findings.
    """

    checked: dict[str, int] = field(default_factory=dict)
    damaged: list[str] = field(default_factory=list)
    different: list[str] = field(default_factory=list)
    unchecked: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    @property
    def holds(self) -> bool:
        """Whether everything was verified and holds."""
        return self.code is ExitCode.OK

    @property
    def code(self) -> ExitCode:
        """Exit code; never 1, which says that a run violates its requirement."""
        if self.damaged:
            return ExitCode.USAGE
        if self.different:
            return ExitCode.INFRA
        return ExitCode.INCOMPLETE if self.unchecked else ExitCode.OK


def verify(
    folder: Path, *, moved: Sequence[Path] = (), networks: tuple[str, ...] = (), sample: int = 5,
    seed: int = 0, on_progress: Progress = lambda stage, done, of: None,
) -> Verification:
    """Verify a folder of evidence.

    Args:
        folder: its folder.
        moved: folders of inputs that have moved: campaigns, localisations, judgements, ODD.
        networks: files of networks that have moved.
        sample: number of runs to drive again.
        seed: chooses them.
        on_progress: called with the stage, what is done of it, and how much there is.
    """
    if absent := [path for path in moved if not path.exists()]:
        raise UsageError(f'campaign {absent[0]}: no such folder')
    found, path = Verification(), folder / JSON_NAME
    _check_files(folder, found)
    try:
        content = _read_json(path)
        again = _again(content, folder, _Places(folder, moved), networks, found, on_progress)
    except UsageError as error:
        found.damaged.append(str(error))
    except (LookupError, TypeError, AttributeError, ValueError) as error:
        found.damaged.append(
            f'{path}: damaged or edited: a value is missing or of another form ({error!r})'
        )
    else:
        if again is not None:
            _compare(content, again, path, found)
            _drive_again(again, networks, random.Random(seed), sample, found, on_progress)
    return found


def _check_files(folder: Path, found: Verification) -> None:
    """Compare the files of the folder with the manifest."""
    manifest = folder / MANIFEST_NAME
    if not folder.is_dir():
        raise UsageError(f'{folder}: no such folder; name one that taxinet evidence has written')
    if not any((folder / name).is_file() for name in (MANIFEST_NAME, JSON_NAME)):
        raise UsageError(f'{folder}: no evidence: neither {MANIFEST_NAME} nor {JSON_NAME} is there')
    if not manifest.is_file():
        found.damaged.append(f'{manifest}: is missing')
        return
    lines = [_LINE.fullmatch(line) for line in manifest.read_text(errors='replace').splitlines()]
    listed = {line[2]: line[1] for line in lines if line}
    if not all(lines):
        found.damaged.append(f'{manifest}: damaged line {lines.index(None) + 1}')
    there = {path.name for path in folder.iterdir()} - {MANIFEST_NAME}
    for name in sorted({*listed, *there}):
        path = folder / name
        if name not in there:
            found.damaged.append(f'{path}: is missing, but listed in {MANIFEST_NAME}')
        elif name not in listed:
            found.damaged.append(f'{path}: is not listed in {MANIFEST_NAME}')
        elif not path.is_file() or file_sha256(path) != listed[name]:
            found.damaged.append(f'{path}: is not the file that {MANIFEST_NAME} lists')
    if not found.damaged:
        found.checked['files'] = len(listed) + 1


def _read_json(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        raise UsageError(f'{path}: is missing')
    content: Mapping[str, Any] = json.loads(path.read_bytes())
    if content['schema'] != SCHEMA:
        raise UsageError(
            f'{path}: is of schema {content["schema"]!r}, this version reads {SCHEMA}'
        )
    return content


def _again(
    content: Mapping[str, Any], folder: Path, places: _Places, networks: tuple[str, ...],
    found: Verification, on_progress: Progress,
) -> Collected | None:
    """The evidence, made again from the inputs; None if one of them is missing or has changed."""
    by_number = sorted(content['campaigns'], key=lambda one: int(one['id'].rpartition('-')[2]))
    campaigns = tuple(places.folder('campaign', one) for one in by_number)
    localisations = tuple(
        places.folder('localisation', one) for one in content['localisations']
    )
    monitors = tuple(places.folder('judgement', one) for one in content['monitors'])
    odd = content['odd']
    word = odd and odd['given']
    if odd and odd['files']:
        word = str(places.folder('ODD', odd) / word)
    if troubles := [*places.troubles, *places.unused()]:
        found.damaged += troubles
        return None
    found.checked['hashes of inputs'] = places.hashes
    requirement = content['requirement']
    return collect(
        campaigns, folder, on_progress, claim=content['claim'], spec=content['asked_spec'],
        odd=word, localisations=localisations, monitors=monitors, networks=networks,
        recorded=places.recorded, names=tuple(one['name'] for one in by_number),
        requirement=None if requirement is None else requirement_of(
            requirement['given'], str(folder / JSON_NAME)
        ),
    )


class _Places:
    """Where inputs are now, found by their hashes.

    Attributes:
        recorded: paths in the evidence, by where the inputs are.
        troubles: what is missing or has changed.
        hashes: number of files that are as recorded.
    """

    def __init__(self, evidence: Path, moved: Sequence[Path]) -> None:
        self._evidence, self._moved = evidence, moved
        self.recorded: dict[Path, str] = {}
        self.troubles: list[str] = []
        self.hashes = 0

    def folder(self, kind: str, one: Mapping[str, Any]) -> Path:
        """Folder of an input: one named as moved with these files, else where it was."""
        files, what = one['files'], f'{kind} {one.get("name", one["id"])}'
        moved = 'if it has moved, name its folder as campaign'
        place = self._evidence / one['path']
        for path in self._moved:
            if all(_sha256(path / name) == sha256 for name, sha256 in files.items()):
                place = path
        self.recorded[place] = one['path']
        if not place.is_dir():
            self.troubles.append(f'{place}: {what} is not there; {moved}')
            return place
        for name, sha256 in files.items():
            now = _sha256(place / name)
            self.hashes += now == sha256
            if not now:
                self.troubles.append(f'{place / name}: is missing; {moved}')
            elif now != sha256:
                self.troubles.append(
                    f'{place / name}: has changed since the evidence was written (sha256 '
                    f'{sha256[:12]}… then, {now[:12]}… now); make the evidence again'
                )
        return place

    def unused(self) -> Iterator[str]:
        """What was named as moved and is none of the inputs."""
        for path in self._moved:
            if path not in self.recorded:
                yield (f'campaign {path}: is none of the inputs, or has changed since the '
                       'evidence was written')


def _sha256(path: Path) -> str:
    return file_sha256(path) if path.is_file() else ''


def _compare(
    content: Mapping[str, Any], again: Collected, path: Path, found: Verification
) -> None:
    """Compare every value with that made again; which code made it may differ."""
    written, now = ({**one, 'computed_by': None} for one in (content, again.content))
    wrong = value_differences(written, now)
    found.damaged += [f'{path}: {line}' for line in wrong]
    if not wrong:
        found.checked['values computed again'] = len(dict(_leaves(now)))


def value_differences(written: Any, now: Any) -> list[str]:
    """Where two JSON values differ, one line a place."""
    before, after = dict(_leaves(written)), dict(_leaves(now))
    return [
        f'{at}: is missing' if at not in before else f'{at}: is not of these inputs'
        if at not in after else f'{at}: is {_short(before[at])}, of these inputs it is '
        f'{_short(after[at])}'
        for at in sorted({*before, *after})
        if at not in before or at not in after
        or (type(before[at]), before[at]) != (type(after[at]), after[at])
    ]


def _leaves(value: Any, at: str = '') -> Iterator[tuple[str, Any]]:
    """All plain values and empty containers, by where they are."""
    if isinstance(value, Mapping) and value:
        for name, inner in value.items():
            yield from _leaves(inner, f'{at}.{name}' if at else str(name))
    elif isinstance(value, list) and value:
        for number, inner in enumerate(value):
            yield from _leaves(inner, f'{at}[{number}]')
    else:
        yield at, value


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f'{text[:79]}…'


# Runs --------------------------------------------------------------------------------------------


def _drive_again(
    again: Collected, networks: tuple[str, ...], chosen_by: random.Random, number: int,
    found: Verification, on_progress: Progress,
) -> None:
    """Drive a sample of the runs again and compare them to the bit."""
    if not number:
        found.notes.append('no run was driven again, as asked by sample 0')
        return
    runs: list[tuple[str, RunRow]] = []
    for name in sorted(again.inputs):
        one = again.inputs[name]
        rows = [(name, row) for row in one.recorded.judged if row.run_id in one.bags]
        why = not_repeatable(one, networks) or (
            '' if rows else 'no run has its bag here, which alone has the exact scene'
        )
        if why:
            found.unchecked.append(f'{one.folder}: no run can be driven again: {why}')
        else:
            runs += rows
    sample = chosen_by.sample(runs, min(number, len(runs)))
    if len(sample) < number and not found.unchecked:
        found.notes.append(f'there are only {len(sample)} runs to drive again')
    loops: dict[str, Loop] = {}
    with tempfile.TemporaryDirectory(prefix='taxinet-evidence-') as scratch:
        for done, (name, row) in enumerate(sorted(
            sample, key=lambda each: (each[0], each[1].index)
        ), 1):
            one, out = again.inputs[name], Path(scratch) / name
            if name not in loops:
                out.mkdir()
                # From there the bag gets the program's text, as in the campaign.
                (out / RECORD_NAME).symlink_to((one.folder / RECORD_NAME).resolve())
                loops[name] = _loop(one, out, networks)
            if difference := run_difference(one, row, loops[name], out):
                found.different.append(f'{one.folder / row.run_id}: driven again: {difference}')
            on_progress('runs', done, len(sample))
    if sample and not found.different:
        found.checked['runs driven again, equal to the bit'] = len(sample)


def not_repeatable(one: CampaignInput, networks: tuple[str, ...] = ()) -> str:
    """Why no run of a campaign can be driven again here; '' if they can."""
    if is_free(str(one.facts.get('timing', ''))):
        return f'free runs: {NOT_REPRODUCIBLE}'
    try:
        usable_network(one.facts, networks)
        return find_world(*recorded_world(one.facts)).again_words
    except UsageError as error:
        return str(error)


def _loop(one: CampaignInput, out: Path, networks: tuple[str, ...]) -> Loop:
    facts = one.facts
    system = dataclasses.replace(
        system_of(one.recorded), perception=usable_network(facts, networks),
        controller_sha256=str(facts.get('controller_sha256', '')),
    )
    return Loop(system, out, str(facts.get('images', 'none')))


def run_difference(one: CampaignInput, row: RunRow, loop: Loop, out: Path) -> str:
    """Drive a run again; the first difference, or ''."""
    bag = one.folder / row.bag
    try:
        result = loop.run(open_recording(bag).run.request)
    except (BagError, UsageError) as error:
        return str(error)
    if not result.outcome.judged:
        return f'{result.outcome}: {result.detail}'
    wrong = [
        f'rho of {name} was {interval}, is now {result.robustness.get(name)}'
        for name, interval in row.robustness.items() if result.robustness.get(name) != interval
    ] or [
        f'messages of {topic.topic} differ'
        for topic in compare_bags(bag, out / row.run_id) if not topic.equal
    ]
    stack = recorded_stacks(one.facts).get(row.stack, {})
    if wrong and stack and (other := differences(stack, provenance())):
        return f'{wrong[0]}; made on another machine or version: {other}'
    return wrong[0] if wrong else ''
