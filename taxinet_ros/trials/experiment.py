"""Confirmation experiments as files: a program, and arms that differ in the suspected cause.

The paper confirms a suspected cause by running the same scenes with and without it (its Fig. 7: the
aircraft's shadow). The YAML format:

    program: halton_time_of_day     # shipped, or a .scenic file, also relative to this file
    runs: 120
    seed: 0                         # default 0
    sampler: halton                 # default random
    perception: original            # default taxinet
    controller: my_file.py:steer    # default steering, the handwritten law
    specs: [phi_eventually]         # the first is the headline
    set: {clouds: clear}            # for all arms, as --set of taxinet run
    over: time_of_day_h             # horizontal axis of the picture; determined if not given
    arms:                           # two or more; each has its own set, perception or controller
      shadows: {}
      no_shadows: {set: {shadows: off}}
    compare_to: shadows             # default: the first arm

Arms run as searches with the same scenes except for the values that each arm overrides.
"""

from __future__ import annotations

import dataclasses
import datetime
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.motion.controller import STEERING, SteeringGains
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario_fields import (
    BY_KEY,
    HUMAN_KEYS,
    SHORT_FORMS,
    by_key,
    by_value,
    split_point,
)
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import Section, expected, read_yaml
from taxinet_ros.samplers.registry import check_sampler
from taxinet_ros.scenes.overrides import NEEDS, check_overrides
from taxinet_ros.scenes.programs import SUFFIX as PROGRAM_SUFFIX
from taxinet_ros.scenes.programs import find_document, find_program, shipped_documents
from taxinet_ros.trials.engine import with_workers
from taxinet_ros.trials.options import GRAPH, CampaignOptions, check_engine, check_new, with_offsets
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.requirements import DEFAULT_SPECS, read_specs
from taxinet_ros.trials.search import Search

SUFFIX = '.yaml'
FOLDER = 'experiments'
PAIRED_SAMPLERS = ('random', 'halton', 'sobol', 'grid')
"""Samplers that do not learn and therefore choose the same scenes for every arm."""
_KEYS = (
    'program', 'runs', 'seed', 'sampler', 'sampler_options', 'perception', 'controller', 'specs',
    'set', 'over', 'arms', 'compare_to',
)
_ARM_KEYS = ('set', 'perception', 'controller')
_ARM_NAME = re.compile(r'[A-Za-z0-9][A-Za-z0-9_-]{0,40}')
_GAIN = 'steering.'


@dataclass(frozen=True, kw_only=True)
class Arm:
    """One arm of an experiment.

    Attributes:
        name: name of the arm and of its folder.
        perception: name or file, or an external node.
        controller: name or file, or an external node.
        laid_over: scenario values that differ from the shared ones, in human keys and units.
        gains: steering gains, including the shared ones.
    """

    name: str
    perception: str
    controller: str = STEERING
    laid_over: Mapping[str, str] = field(default_factory=dict)
    gains: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """A confirmation experiment.

    Attributes:
        name: name of its file.
        program: name of a shipped program, or path of one.
        runs: number of scenes, each run once in every arm.
        seed, sampler, sampler_options: how the scenes are chosen.
        specs: formulas as self-contained text; the first is the headline.
        overrides: scenario values shared by all arms.
        over: scenario key on the x axis of the plot, or ''.
        arms: two or more.
        compare_to: name of the arm that the others are compared to.
    """

    name: str
    program: str
    runs: int
    seed: int
    sampler: str
    sampler_options: Mapping[str, str]
    specs: tuple[str, ...]
    overrides: Mapping[str, str]
    over: str
    arms: tuple[Arm, ...]
    compare_to: str

    @property
    def others(self) -> tuple[Arm, ...]:
        """The arms other than ``compare_to``."""
        return tuple(arm for arm in self.arms if arm.name != self.compare_to)


def known_experiments() -> tuple[str, ...]:
    """Sorted names of the shipped experiments."""
    return shipped_documents(FOLDER, SUFFIX)


def find_experiment(word_or_path: str) -> Path:
    """Find the file of a shipped experiment's name, or of a path.

    Raises:
        UsageError: it is neither; the known names are listed.
    """
    return find_document(
        word_or_path, FOLDER, SUFFIX,
        f'experiment {word_or_path!r}: no such file, and no shipped experiment',
    )


def read_experiment(path: Path) -> Experiment:
    """Read an experiment.

    Raises:
        UsageError: one line with the file, the key, and the expected value.
    """
    top = Section(path, read_yaml(path), _KEYS)
    for key, kind in (('program', 'a word'), ('runs', 'a whole number'), ('arms', 'two or more')):
        top.take(key, kind)
    overrides, gains = _settings(top)
    perception = _perception(top, 'taxinet')
    controller = _controller(top, STEERING, gains)
    arms = _arms(top.section('arms'), overrides, gains, perception, controller)
    compare_to = top.text('compare_to', arms[0].name)
    if compare_to not in [arm.name for arm in arms]:
        names = ', '.join(arm.name for arm in arms)
        raise top.wrong(f'expected one of the arms ({names}), got {compare_to}', 'compare_to')
    sampler, options = _sampler(top)
    over = top.text('over', '', empty=True)
    over = SHORT_FORMS.get(over, over)
    if over and over not in HUMAN_KEYS:
        raise top.wrong(f'expected one of {", ".join(HUMAN_KEYS)}, got {over}', 'over')
    return Experiment(
        name=path.stem, program=_program(top), runs=top.whole('runs', 1),
        seed=top.whole('seed', 0, default=0), sampler=sampler, sampler_options=options,
        specs=_specs(top), overrides=overrides, over=over, arms=arms, compare_to=compare_to,
    )


def _arms(
    given: Section, overrides: Mapping[str, str], gains: Mapping[str, float], perception: str,
    controller: str,
) -> tuple[Arm, ...]:
    arms = []
    for name in given:
        if not _ARM_NAME.fullmatch(name):
            raise given.wrong('expected a name of letters, digits, _ and -', name)
        own = given.section(name, _ARM_KEYS, optional=True)
        laid_over, own_gains = _settings(own)
        own.check('set', partial(check_overrides, {**overrides, **laid_over}))
        gains_here = {**gains, **own_gains}
        arms.append(Arm(
            name=name, laid_over=laid_over, gains=gains_here,
            perception=_perception(own, perception),
            controller=_controller(own, controller, gains_here),
        ))
    if len(arms) < 2:
        raise given.wrong('expected two or more, NAME: {set: {KEY: VALUE}}')
    for one, other in itertools.combinations(arms, 2):
        if _what_runs(one, overrides) == _what_runs(other, overrides):
            raise given.wrong(
                f'runs the same as {one.name}, so there is nothing to compare; give it another '
                'set, perception or controller', other.name,
            )
    return tuple(arms)


def _what_runs(arm: Arm, overrides: Mapping[str, str]) -> tuple[object, ...]:
    return (
        by_value({**overrides, **arm.laid_over}), SteeringGains(**arm.gains), arm.perception,
        arm.controller,
    )


def _settings(given: Section) -> tuple[dict[str, str], dict[str, float]]:
    """Scenario values and gains under the key ``set``."""
    settings = given.section('set', optional=True)
    texts = {key: _setting(settings, key) for key in settings}
    overrides = {key: text for key, text in texts.items() if not key.startswith(_GAIN)}
    given.check('set', lambda: check_overrides(overrides))
    overrides = {
        key: BY_KEY[key].settled(text) if key in BY_KEY else text
        for key, text in with_offsets(overrides).items()
    }
    gains: dict[str, float] = {}
    for key in texts.keys() - overrides.keys():
        name = key.removeprefix(_GAIN)
        if name not in SteeringGains.__dataclass_fields__:
            known = ', '.join(SteeringGains.__dataclass_fields__)
            raise settings.wrong(f'unknown gain; known: {known}', key)
        try:
            gains[name] = float(texts[key])
        except ValueError:
            raise settings.wrong(f'expected a number, got {texts[key]}', key) from None
    given.check('set', lambda: SteeringGains(**gains))
    return by_key(overrides), gains


def _setting(given: Section, key: str) -> str:
    """A value as text for --set: YAML parses off as false, and a date as a date."""
    kind = 'a number, a word, on or off'
    value = given.take(key, kind)
    if isinstance(value, bool):
        return 'on' if value else 'off'
    if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
        return value.isoformat()
    if isinstance(value, str | int | float):
        return str(value)
    raise given.wrong(expected(kind, value), key)


def _program(given: Section) -> str:
    word = given.text('program')
    beside = given.path.parent / word
    if word.endswith(PROGRAM_SUFFIX) and beside.is_file():
        return str(beside)
    given.check('program', lambda: find_program(word))
    return word


def _perception(given: Section, default: str) -> str:
    word = given.text('perception', default)
    given.check('perception', lambda: check_perception(word, graph=True))
    return word


def _controller(given: Section, default: str, gains: Mapping[str, float]) -> str:
    word = given.text('controller', default)
    given.check('controller', lambda: check_controller(word, gains, graph=True))
    return word


def _specs(given: Section) -> tuple[str, ...]:
    if 'specs' not in given:
        return DEFAULT_SPECS
    value = given.take('specs', 'formulas')
    words = [value] if isinstance(value, str) else [] if value is None else value
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise given.wrong(expected('a list of formulas', value), 'specs')
    found: list[str] = []
    given.check('specs', lambda: found.extend(read_specs(words)))
    return tuple(found) or DEFAULT_SPECS


def _sampler(given: Section) -> tuple[str, dict[str, str]]:
    word = given.text('sampler', 'random')
    if word not in PAIRED_SAMPLERS:
        raise given.wrong(f'expected one of {", ".join(PAIRED_SAMPLERS)}, for all arms need the '
                          f'same scenes; got {word}', 'sampler')
    settings = given.section('sampler_options', optional=True)
    options = {key: _setting(settings, key) for key in settings}
    given.check('sampler_options', lambda: check_sampler(word, options))
    return word, options


PAIRS_NAME, JSON_NAME, PAGE_NAME = 'pairs.parquet', 'experiment.json', 'experiment.html'
"""Result files in the folder of the arms; the second has checksums of the others."""


def with_network(experiment: Experiment, perception: str) -> Experiment:
    """The experiment with another network in all its arms.

    Args:
        experiment: the experiment.
        perception: word or file.

    Raises:
        UsageError: there is no such network, or the arms differ in their network.
    """
    check_perception(perception, graph=True)
    if len({arm.perception for arm in experiment.arms}) > 1:
        raise UsageError(
            f'perception {perception}: the arms of {experiment.name} differ in their network; '
            'leave it out'
        )
    arms = tuple(dataclasses.replace(arm, perception=perception) for arm in experiment.arms)
    return dataclasses.replace(experiment, arms=arms)


def arm_searches(
    experiment: Experiment, out: Path, *, workers: int, resume: bool, engine: str = GRAPH,
    audit: str | None = None, cluster: str | None = None,
) -> dict[str, Search]:
    """One search per arm, in its own folder, by name of the arm.

    Args:
        experiment: the experiment to run.
        out: folder of the experiment.
        workers: number of concurrent graphs.
        resume: continue the existing arms.
        engine: what makes the runs, see :class:`.CampaignOptions`.
        audit: share of the runs to audit as text, see :func:`.check_engine`.
        cluster: a Dask cluster as for :func:`.pool.check_cluster`, or None.

    Raises:
        UsageError: the folder, the number of workers, the cluster or the engine cannot be used.
    """
    campaigns = {
        arm.name: with_workers(_campaign(experiment, arm, out, engine, audit), workers, cluster)
        for arm in experiment.arms
    }
    if not resume:
        check_new(out)
    elif not _may_be_begun(experiment, out):
        raise UsageError(f'resume: {out}: holds no arm of {experiment.name}; leave resume out')
    return {
        arm.name: Search(
            dataclasses.replace(
                campaigns[arm.name], resume=resume and is_campaign(out / arm.name)
            ),
            sampler=experiment.sampler, sampler_options=experiment.sampler_options,
        )
        for arm in experiment.arms
    }


def _may_be_begun(experiment: Experiment, out: Path) -> bool:
    """Whether a folder contains arms of the experiment, even one that has only been created."""
    arms = {arm.name for arm in experiment.arms}
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    return bool(there) and (
        there <= arms or any(is_campaign(out / name) for name in arms)
    )


def arm_rows(experiment: Experiment, out: Path) -> dict[str, Sequence[RunRow]]:
    """The runs of every arm by name."""
    return {arm.name: read_campaign(out / arm.name).rows for arm in experiment.arms}


def check_paired(
    experiment: Experiment, rows: Mapping[str, Sequence[RunRow]]
) -> None:
    """Check that the arms have the same scenes except for each arm's own values.

    Raises:
        UsageError: two scenes with the same index differ otherwise, so they cannot be compared.
    """
    first = experiment.compare_to
    base = {row.index: row for row in rows[first]}
    touched = {arm.name: set(arm.laid_over) for arm in experiment.arms}
    for arm in experiment.others:
        free = touched[first] | touched[arm.name]
        for row in rows[arm.name]:
            other = base.get(row.index)
            if other is None or not (row.clouds and other.clouds):
                continue  # no scene was drawn, or not yet
            for key in {**row.scene, **other.scene}:
                value, there = row.scene.get(key), other.scene.get(key)
                if value != there and free.isdisjoint((key, *NEEDS.get(split_point(key)[0], ()))):
                    raise UsageError(
                        f'experiment {experiment.name}: run {row.index} has {key} '
                        f'{value} in {arm.name} and {there} in {first}, '
                        'though neither arm sets it; was the program changed between the arms?'
                    )


def _campaign(
    experiment: Experiment, arm: Arm, out: Path, engine: str, audit: str | None
) -> CampaignOptions:
    campaign = CampaignOptions(
        program=experiment.program, runs=experiment.runs, seed=experiment.seed,
        perception=arm.perception, out=out / arm.name, overrides=experiment.overrides,
        controller=arm.controller, laid_over=arm.laid_over, gains=arm.gains,
        judging=Judging(specs=experiment.specs), images='none',
        arms=tuple(one.name for one in experiment.arms), engine=engine,
    )
    return dataclasses.replace(campaign, audit_percent=check_engine(engine, audit, campaign))
