"""Verify evidence: every byte, every hash, every figure, and a sample of the runs.

Nothing of the evidence is believed: figures, limits, argument and drawing are made again from the
inputs by the function that made them first, and compared value by value. Runs of the sample are
driven again without ROS and compared by their robustness and by their bags, to the bit.
"""

from __future__ import annotations

import itertools
import random
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.audit import bag_difference
from taxinet_ros.campaign.loop_run import Loop, LoopOptions
from taxinet_ros.campaign.record.facts import (
    FACTS_NAME,
    recorded_stacks,
    recorded_world,
)
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE, is_free, parse_timing
from taxinet_ros.core.provenance import differences, provenance
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.extras.evidence.document import (
    JSON_NAME,
    PAGE_NAME,
    SVG_NAME,
    Collected,
    EvidenceOptions,
    collect,
)
from taxinet_ros.extras.evidence.drawing import argument_svg
from taxinet_ros.extras.evidence.folder import read_evidence, write_page
from taxinet_ros.extras.evidence.inputs import (
    CampaignInput,
    Place,
    requirement_of,
    usable_network,
)
from taxinet_ros.files.sealed_json import file_sha256

Progress = Callable[[str, int, int], None]
_MADE_ON = 'This page was made on '
_BROKEN = (KeyError, TypeError, ValueError, AttributeError, IndexError)
"""What reading values of another form raises."""


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
        """Exit code.

        0 everything holds; 2 files or inputs are damaged, missing or changed, or figures are not
        those of their inputs; 4 a run cannot be repeated to the bit here; 3 something could not be
        verified. Never 1, which says that a run violates its requirement.
        """
        if self.damaged:
            return ExitCode.USAGE
        if self.different:
            return ExitCode.INFRA
        return ExitCode.INCOMPLETE if self.unchecked else ExitCode.OK

    def count(self, what: str, number: int = 1) -> None:
        """Count things that hold."""
        self.checked[what] = self.checked.get(what, 0) + number


@dataclass(frozen=True, kw_only=True)
class VerifyOptions:
    """How evidence is verified.

    Attributes:
        folder: its folder.
        moved: folders or files of inputs that have moved: campaigns, localisations, monitors, ODD.
        networks: files of networks that have moved.
        sample: number of runs to drive again.
        seed: chooses them.

    Raises:
        UsageError: a negative number.
    """

    folder: Path
    moved: tuple[Path, ...] = ()
    networks: tuple[str, ...] = ()
    sample: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        if self.sample < 0:
            raise UsageError(f'--sample {self.sample}: needs to be 0 or more')
        for path in self.moved:
            if not path.exists():
                raise UsageError(f'--campaign {path}: no such folder')


def verify(
    options: VerifyOptions, on_progress: Progress = lambda stage, done, of: None,
) -> Verification:
    """Verify a folder of evidence.

    Args:
        options: what and how.
        on_progress: called with the stage, what is done of it, and how much there is.

    Raises:
        UsageError: the folder is none of evidence, or an input named as moved is none of it.
    """
    found = Verification()
    kept = read_evidence(options.folder)
    found.damaged += kept.troubles
    if not kept.content:
        return found
    if not kept.troubles:
        found.count('files', kept.files)
    try:
        places = _places(kept.content, options, found)
        if places is None:
            return found
        again = _again(kept.content, places, options, on_progress)
    except UsageError as error:
        found.damaged.append(str(error))
        return found
    except _BROKEN as error:
        found.damaged.append(
            f'{options.folder / JSON_NAME}: damaged or edited: a value is missing or of another '
            f'form ({error!r})'
        )
        return found
    _compare(kept.content, again, options, found)
    if options.sample:
        _drive_again(again, options, found, on_progress)
    else:
        found.notes.append('no run was driven again, as asked by --sample 0')
    return found


# Inputs ------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class _Places:
    """Where the inputs are now, in the order in which they were named."""

    campaigns: tuple[Path, ...]
    localisations: tuple[Path, ...]
    monitors: tuple[Path, ...]
    odd: str | None
    where: Mapping[Path, Place]


def _places(
    content: Mapping[str, Any], options: VerifyOptions, found: Verification
) -> _Places | None:
    """Find all inputs and check their hashes; None if one is missing or has changed."""
    unused = list(options.moved)
    where: dict[Path, Place] = {}

    def find(kind: str, one: Mapping[str, Any]) -> Path:
        recorded = options.folder / one['path']
        place = Place(one['path'], one.get('name', ''))
        files: Mapping[str, str] = one['files']
        for path in options.moved:
            if path.is_dir() and all(_sha256(path / name) == sha for name, sha in files.items()):
                unused[:] = [left for left in unused if left != path]
                where[path] = place
                return path
        where[recorded] = place
        _check_files(f'{kind} {one.get("name", one["id"])}', recorded, files, found)
        return recorded

    by_number = sorted(content['campaigns'], key=lambda one: int(one['id'].rpartition('-')[2]))
    before = len(found.damaged)
    campaigns = tuple(find('campaign', one) for one in by_number)
    localisations = tuple(find('localisation', one) for one in content['localisations'])
    monitors = tuple(find('monitor table', one) for one in content['monitors'])
    odd = _find_odd(content['odd'], options, unused, where, found)
    if unused:
        listed = ', '.join(map(str, unused))
        found.damaged.append(
            f'--campaign {listed}: is none of the inputs, or has changed since the evidence was '
            'written'
        )
    if len(found.damaged) > before:
        return None
    inputs = (*by_number, *content['localisations'], *content['monitors'])
    found.count('hashes of inputs', sum(len(one['files']) for one in inputs) + bool(odd))
    return _Places(campaigns=campaigns, localisations=localisations, monitors=monitors, odd=odd,
                   where=where)


def _sha256(path: Path) -> str:
    return file_sha256(path) if path.is_file() else ''


def _check_files(
    what: str, folder: Path, files: Mapping[str, str], found: Verification
) -> None:
    if not folder.is_dir():
        found.damaged.append(
            f'{folder}: {what} is not there; if it has moved, name its folder with --campaign'
        )
        return
    for name, sha256 in files.items():
        path = folder / name
        if not path.is_file():
            found.damaged.append(f'{path}: is missing')
        elif (now := file_sha256(path)) != sha256:
            found.damaged.append(
                f'{path}: has changed since the evidence was written (sha256 {sha256[:12]}… then, '
                f'{now[:12]}… now); make the evidence again'
            )


def _find_odd(
    odd: Mapping[str, Any] | None, options: VerifyOptions, unused: list[Path],
    where: dict[Path, Place], found: Verification,
) -> str | None:
    """Name or file of the ODD; its hash is compared with the other values."""
    if odd is None:
        return None
    given = str(odd['given'])
    for path in options.moved:
        if _sha256(path) == odd['sha256']:
            unused[:] = [left for left in unused if left != path]
            where[path] = Place(given)
            return str(path)
    recorded = options.folder / given
    if '/' not in given and not given.endswith('.yaml'):
        return given  # a shipped one
    if not recorded.is_file():
        found.damaged.append(
            f'{recorded}: ODD {odd["name"]} is not there; if it has moved, name it with --campaign'
        )
    elif file_sha256(recorded) != odd['sha256']:
        found.damaged.append(f'{recorded}: has changed since the evidence was written')
    where[recorded] = Place(given)
    return str(recorded)


def _again(
    content: Mapping[str, Any], places: _Places, options: VerifyOptions, on_progress: Progress,
) -> Collected:
    """The evidence, made again from the inputs."""
    requirement = content['requirement']
    bags = sum(int(one['bags']['runs']) for one in content['campaigns'])
    done = itertools.count(1)
    return collect(
        EvidenceOptions(
            campaigns=places.campaigns, claim=content['claim'], spec=content['asked_spec'],
            odd=places.odd, monitors=places.monitors, localisations=places.localisations,
            networks=options.networks,
        ),
        options.folder, where=places.where,
        on_bag=lambda bag: on_progress('bags', min(next(done), bags), bags),
        requirement=None if requirement is None else requirement_of(
            requirement['given'], str(options.folder / JSON_NAME)
        ),
    )


# Values ------------------------------------------------------------------------------------------


def _compare(
    content: Mapping[str, Any], again: Collected, options: VerifyOptions, found: Verification
) -> None:
    """Compare every value, the drawing and the page with those made again."""
    told = {name: value for name, value in content.items() if name != 'computed_by'}
    now = {name: value for name, value in again.content.items() if name != 'computed_by'}
    wrong = list(value_differences(told, now))
    path = options.folder / JSON_NAME
    found.damaged += [f'{path}: {line}' for line in wrong]
    if not wrong:
        found.count('values computed again', sum(1 for _ in _leaves(now)))
    drawing = options.folder / SVG_NAME
    if drawing.is_file() and drawing.read_text(encoding='utf-8', errors='replace') != argument_svg(
        again.argument
    ):
        found.damaged.append(f'{drawing}: is not the drawing of the argument of these inputs')
    _compare_page(content, again, options, found)


def value_differences(told: Any, now: Any, at: str = '') -> Iterator[str]:
    """Where two JSON values differ: ``path: written … | computed …``."""
    if isinstance(told, Mapping) and isinstance(now, Mapping):
        for name in sorted({*told, *now}):
            inner = f'{at}.{name}' if at else str(name)
            if name not in told or name not in now:
                yield f'{inner}: {"is missing" if name in now else "is not of these inputs"}'
            else:
                yield from value_differences(told[name], now[name], inner)
    elif isinstance(told, list) and isinstance(now, list):
        if len(told) != len(now):
            yield f'{at}: has {len(told)} entries, of these inputs there are {len(now)}'
            return
        for number, (one, other) in enumerate(zip(told, now, strict=True)):
            yield from value_differences(one, other, f'{at}[{_key(one, number)}]')
    elif type(told) is not type(now) or told != now:
        yield f'{at}: is {_short(told)}, of these inputs it is {_short(now)}'


def _key(one: Any, number: int) -> str:
    """How an entry of a list is called: by its id or formula if it has one."""
    if isinstance(one, Mapping):
        for name in ('id', 'formula', 'name', 'key', 'label'):
            if isinstance(one.get(name), str):
                return str(one[name])
    return str(number)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f'{text[:79]}…'


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, Mapping):
        for inner in value.values():
            yield from _leaves(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _leaves(inner)
    else:
        yield value


def _compare_page(
    content: Mapping[str, Any], again: Collected, options: VerifyOptions, found: Verification
) -> None:
    """Compare the page with one made now; another version or machine may draw it otherwise."""
    path = options.folder / PAGE_NAME
    if not path.is_file():
        return
    with tempfile.TemporaryDirectory() as scratch:
        other = Path(scratch) / PAGE_NAME
        write_page(again, other, _sha256(options.folder / JSON_NAME))
        before, now = (
            one.read_text(encoding='utf-8', errors='replace') for one in (path, other)
        )
    # What it says of the machine that wrote it cannot be computed again; it is text, no markup.
    there, own = _made_on(before), _made_on(now)
    if there and '<' not in there:
        now = now.replace(f'{_MADE_ON}{own}</p>', f'{_MADE_ON}{there}</p>')
    if before == now:
        return
    elsewhere = (
        'by another version' if content.get('computed_by') != again.content['computed_by']
        else 'on another machine' if there not in ('', own) else ''
    )
    if elsewhere:
        found.unchecked.append(
            f'{path}: is not the page that this version makes here of these inputs, and says that '
            f'it was written {elsewhere}; values and drawing are checked, this page is not'
        )
    else:
        found.damaged.append(f'{path}: is not the page of these inputs')


def _made_on(page: str) -> str:
    return page.partition(_MADE_ON)[2].partition('</p>')[0]


# Runs --------------------------------------------------------------------------------------------


def _drive_again(
    again: Collected, options: VerifyOptions, found: Verification, on_progress: Progress
) -> None:
    """Drive a sample of the runs again and compare them to the bit."""
    runs: list[tuple[str, RunRow]] = []
    reasons: dict[str, str] = {}
    for name in sorted(again.inputs):
        one = again.inputs[name]
        why = not_repeatable(one, options.networks)
        here = [] if why else [
            (name, row) for row in one.rows if row.outcome.judged and row.run_id in one.bags
        ]
        runs += here
        if not here:
            reasons[name] = why or 'no run has its bag here, which alone has the exact scene'
    sample = random.Random(options.seed).sample(runs, min(options.sample, len(runs)))
    found.unchecked += [
        f'{again.inputs[name].folder}: no run can be driven again: {why}'
        for name, why in reasons.items()
    ]
    if not reasons and len(sample) < options.sample:
        found.notes.append(f'there are only {len(sample)} runs to drive again')
    loops: dict[str, Loop] = {}
    elsewhere: dict[str, None] = {}
    with tempfile.TemporaryDirectory(prefix='taxinet-evidence-') as scratch:
        ordered = sorted(sample, key=lambda each: (each[0], each[1].index))
        for done, (name, row) in enumerate(ordered, 1):
            one, out = again.inputs[name], Path(scratch) / name
            if name not in loops:
                out.mkdir()
                # From there the bag gets the program's text, as in the campaign.
                (out / FACTS_NAME).symlink_to((one.folder / FACTS_NAME).resolve())
                loops[name] = Loop(_loop_options(one, out, options.networks))
            difference = run_difference(one, row, loops[name], out)
            if difference:
                found.different.append(f'{one.folder / row.run_id}: driven again: {difference}')
            else:
                found.count('runs driven again, equal to the bit')
                if other := _made_elsewhere(one, row):
                    elsewhere[other] = None
            on_progress('runs', done, len(ordered))
    found.notes += [
        f'runs were made on another machine or version, so bags were compared by message: {other}'
        for other in elsewhere
    ]


def not_repeatable(one: CampaignInput, networks: Sequence[str] = ()) -> str:
    """Why no run of a campaign can be driven again here; '' if they can."""
    facts = one.facts
    timing = str(facts.get('timing', ''))
    if is_free(timing):
        return f'free runs: {NOT_REPRODUCIBLE}'
    try:
        usable_network(facts, networks)
        if again := find_world(*recorded_world(facts)).again_words:
            return again
    except UsageError as error:
        return str(error)
    return ''


def _loop_options(one: CampaignInput, out: Path, networks: Sequence[str]) -> LoopOptions:
    facts = one.facts
    world, sha256 = recorded_world(facts)
    return LoopOptions(
        perception=usable_network(facts, networks),
        controller=str(facts.get('controller', STEERING)),
        controller_sha256=str(facts.get('controller_sha256', '')),
        gains=dict(facts.get('gains', {})), timing=parse_timing(str(facts.get('timing', ''))),
        world=world, world_sha256=sha256, out=out, images=str(facts.get('images', 'none')),
    )


def run_difference(one: CampaignInput, row: RunRow, loop: Loop, out: Path) -> str:
    """Drive a run again; the first difference, or ''.

    Args:
        one: its campaign.
        row: its row.
        loop: what runs it, with bags below ``out``.
        out: an empty folder.
    """
    bag = one.folder / row.bag
    try:
        result = loop.run(open_recording(bag).run.request)
    except (BagError, UsageError) as error:
        return str(error)
    if not result.outcome.judged:
        return f'{result.outcome}: {result.detail}'
    words = _result_difference(row, result.robustness)
    other = _made_elsewhere(one, row)
    if not words and other:  # the bag records machine and versions, so its bytes differ
        wrong = [topic.topic for topic in compare_bags(bag, out / row.run_id) if not topic.equal]
        words = f'messages of {", ".join(wrong)} differ' if wrong else ''
    elif not words:
        words = bag_difference(bag, out / row.run_id)
    return f'{words}; made on another machine or version: {other}' if words and other else words


def _made_elsewhere(one: CampaignInput, row: RunRow) -> str:
    """How machine and versions of a run differ from those here; '' if they do not."""
    stack = recorded_stacks(one.facts).get(row.stack, {})
    return differences(stack, provenance()) if stack else ''


def _result_difference(row: RunRow, now: Mapping[str, Any]) -> str:
    for name, interval in row.robustness.items():
        if now.get(name) != interval:
            return f'rho of {name} was {interval}, is now {now.get(name)}'
    return ''
