"""Confirmation experiments as files: a program, and arms that differ in what is under suspicion.

The paper confirms a suspected cause by running the same scenes with and without it (its Fig. 7: the
aircraft's shadow). A file says that in YAML::

    program: halton_time_of_day     # shipped, or a .scenic file, also beside this one
    runs: 120
    seed: 0                         # 0 where left out
    sampler: halton                 # random where left out
    perception: original            # taxinet where left out
    controller: my_file.py:steer    # steering, the handwritten law, where left out
    specs: [phi_eventually]         # the first is the headline
    set: {clouds: clear}            # for all arms, as --set of taxinet run
    over: time_of_day               # what the picture is drawn over; found out where left out
    arms:                           # two or more; each has its own set, perception or controller
      shadows: {}
      no_shadows: {set: {shadows: off}}
    compare_to: shadows             # the first arm where left out

The arms of a confirmation experiment as searches: the same scenes, but for what is laid over.
"""

from __future__ import annotations

import dataclasses
import datetime
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.options import DEFAULT_SPECS, CampaignOptions, check_new, read_specs
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.record.ledger import read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.samplers.registry import check_sampler
from taxinet_ros.campaign.samplers.sampler import LAG
from taxinet_ros.campaign.scenes.overrides import check_overrides
from taxinet_ros.campaign.scenes.programs import SUFFIX as PROGRAM_SUFFIX
from taxinet_ros.campaign.scenes.programs import find_program, shipped_folder
from taxinet_ros.campaign.search_options import SearchOptions
from taxinet_ros.core.controller import STEERING, SteeringGains, check_controller
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario_fields import HUMAN_KEYS
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import YamlFile, read_yaml

SUFFIX = '.yaml'
FOLDER = 'experiments'
PAIRED_SAMPLERS = ('random', 'halton', 'sobol', 'grid')
"""Samplers that learn nothing from results, and so choose the same scenes for every arm."""
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
        name: of it and of its folder.
        perception: word or file, or a node of somebody's.
        controller: likewise.
        laid_over: scenario values that differ from the shared ones, human keys and units.
        gains: steering gains, the shared ones included.
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
        name: of its file.
        program: word of a shipped program, or path of one.
        runs: scenes, each run once in every arm.
        seed, sampler, sampler_options: how the scenes are chosen.
        specs: formulas as text that needs no file; the first is the headline.
        overrides: scenario values that all arms share.
        over: key of the scenario that the picture is drawn over, or ''.
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
        """The arms that are compared."""
        return tuple(arm for arm in self.arms if arm.name != self.compare_to)


def known_experiments() -> tuple[str, ...]:
    """Words of the shipped experiments, sorted."""
    return tuple(sorted(path.stem for path in (shipped_folder() / FOLDER).glob(f'*{SUFFIX}')))


def find_experiment(word_or_path: str) -> Path:
    """The file meant by a shipped experiment's word, or by a path.

    Raises:
        UsageError: neither; the known words are listed.
    """
    if word_or_path in known_experiments():
        return shipped_folder() / FOLDER / f'{word_or_path}{SUFFIX}'
    path = Path(word_or_path)
    if not path.is_file():
        raise UsageError(
            f'experiment {word_or_path!r}: no such file, and no shipped experiment; known: '
            f'{", ".join(known_experiments())}'
        )
    return path


def read_experiment(path: Path) -> Experiment:
    """Read an experiment.

    Raises:
        UsageError: one line with the file, the key, and what is expected there.
    """
    return _Reader(path).experiment()


class _Reader(YamlFile):
    """Reads one file."""

    def experiment(self) -> Experiment:
        content = self._mapping('', read_yaml(self._path), _KEYS)
        for key in ('program', 'runs', 'arms'):
            if key not in content:
                raise self._wrong('', f'the key {key!r} is missing')
        overrides, gains = self._settings('set', content.get('set'))
        perception = self._perception('perception', content.get('perception', 'taxinet'))
        controller = self._controller('controller', content.get('controller', STEERING), gains)
        arms = self._arms(content['arms'], overrides, gains, perception, controller)
        compare_to = self._word('compare_to', content.get('compare_to', arms[0].name))
        if compare_to not in [arm.name for arm in arms]:
            names = ', '.join(arm.name for arm in arms)
            raise self._wrong('compare_to', f'expected one of the arms ({names}), got {compare_to}')
        sampler, options = self._sampler(content)
        over = self._word('over', content.get('over', ''), empty=True)
        if over and over not in HUMAN_KEYS:
            raise self._wrong('over', f'expected one of {", ".join(HUMAN_KEYS)}, got {over}')
        return Experiment(
            name=self._path.stem, program=self._program(content['program']),
            runs=self._whole('runs', content['runs'], 1),
            seed=self._whole('seed', content.get('seed', 0), 0),
            sampler=sampler, sampler_options=options, specs=self._specs(content.get('specs')),
            overrides=overrides, over=over, arms=arms, compare_to=compare_to,
        )

    def _arms(
        self, value: object, overrides: Mapping[str, str], gains: Mapping[str, float],
        perception: str, controller: str,
    ) -> tuple[Arm, ...]:
        arms = []
        for name, content in self._mapping('arms', value).items():
            where = f'arms.{name}'
            if not _ARM_NAME.fullmatch(name):
                raise self._wrong(where, 'expected a name of letters, digits, _ and -')
            own = self._mapping(where, {} if content is None else content, _ARM_KEYS)
            laid_over, own_gains = self._settings(f'{where}.set', own.get('set'))
            self._checked(f'{where}.set', partial(check_overrides, {**overrides, **laid_over}))
            gains_here = {**gains, **own_gains}
            arms.append(Arm(
                name=name, laid_over=laid_over, gains=gains_here,
                perception=self._perception(
                    f'{where}.perception', own.get('perception', perception)
                ),
                controller=self._controller(
                    f'{where}.controller', own.get('controller', controller), gains_here
                ),
            ))
        if len(arms) < 2:
            raise self._wrong('arms', 'expected two or more, NAME: {set: {KEY: VALUE}}')
        return tuple(arms)

    def _settings(self, where: str, value: object) -> tuple[dict[str, str], dict[str, float]]:
        settings = self._mapping(where, {} if value is None else value)
        texts = {key: self._plain(f'{where}.{key}', one) for key, one in settings.items()}
        overrides = {key: text for key, text in texts.items() if not key.startswith(_GAIN)}
        self._checked(where, lambda: check_overrides(overrides))
        gains: dict[str, float] = {}
        for key in texts.keys() - overrides.keys():
            name = key.removeprefix(_GAIN)
            if name not in SteeringGains.__dataclass_fields__:
                known = ', '.join(SteeringGains.__dataclass_fields__)
                raise self._wrong(f'{where}.{key}', f'unknown gain; known: {known}')
            try:
                gains[name] = float(texts[key])
            except ValueError:
                what = f'expected a number, got {texts[key]}'
                raise self._wrong(f'{where}.{key}', what) from None
        self._checked(where, lambda: SteeringGains(**gains))
        return overrides, gains

    def _plain(self, where: str, value: object) -> str:
        """A value as --set takes it: YAML has read off as false, and a date as a date."""
        if isinstance(value, bool):
            return 'on' if value else 'off'
        if isinstance(value, datetime.date) and not isinstance(value, datetime.datetime):
            return value.isoformat()
        if isinstance(value, str | int | float):
            return str(value)
        raise self._wrong(where, f'expected a number, a word, on or off, got {value!r:.60}')

    def _program(self, value: object) -> str:
        word = self._word('program', value)
        beside = self._path.parent / word
        if word.endswith(PROGRAM_SUFFIX) and beside.is_file():
            return str(beside)
        self._checked('program', lambda: find_program(word))
        return word

    def _perception(self, where: str, value: object) -> str:
        word = self._word(where, value)
        self._checked(where, lambda: check_perception(word, graph=True))
        return word

    def _controller(self, where: str, value: object, gains: Mapping[str, float]) -> str:
        word = self._word(where, value)
        self._checked(where, lambda: check_controller(word, gains, graph=True))
        return word

    def _specs(self, value: object) -> tuple[str, ...]:
        words = [value] if isinstance(value, str) else value
        if words is None:
            return DEFAULT_SPECS
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
            raise self._wrong('specs', f'expected a list of formulas, got {value!r:.60}')
        found: list[str] = []
        self._checked('specs', lambda: found.extend(read_specs(words)))
        return tuple(found) or DEFAULT_SPECS

    def _sampler(self, content: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
        word = self._word('sampler', content.get('sampler', 'random'))
        if word not in PAIRED_SAMPLERS:
            raise self._wrong('sampler', f'expected one of {", ".join(PAIRED_SAMPLERS)}, for all '
                              f'arms need the same scenes; got {word}')
        given = self._mapping('sampler_options', content.get('sampler_options', {}))
        options = {key: self._plain(f'sampler_options.{key}', v) for key, v in given.items()}
        self._checked('sampler_options', lambda: check_sampler(word, options))
        return word, options

    def _word(self, where: str, value: object, *, empty: bool = False) -> str:
        if not isinstance(value, str) or not (value or empty):
            raise self._wrong(where, f'expected a word, got {value!r:.60}')
        return value

    def _whole(self, where: str, value: object, least: int) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise self._wrong(where, f'expected a whole number, {least} or more, got {value!r:.60}')
        return value


PAIRS_NAME, JSON_NAME, PAGE_NAME = 'pairs.parquet', 'experiment.json', 'experiment.html'
"""What lies beside the arms once all have had their runs; the second vouches for the rest."""


def with_network(experiment: Experiment, perception: str) -> Experiment:
    """The experiment with another network in all its arms.

    Args:
        experiment: the experiment.
        perception: word or file.

    Raises:
        UsageError: there is no such network, or it is the network that the arms differ in.
    """
    check_perception(perception, graph=True)
    if len({arm.perception for arm in experiment.arms}) > 1:
        raise UsageError(
            f'--perception {perception}: the arms of {experiment.name} differ in their network; '
            'leave the option out'
        )
    arms = tuple(dataclasses.replace(arm, perception=perception) for arm in experiment.arms)
    return dataclasses.replace(experiment, arms=arms)


def arm_searches(
    experiment: Experiment, out: Path, *, workers: int, resume: bool
) -> dict[str, SearchOptions]:
    """One search for each arm, in a folder of its own, by the arm's name.

    Args:
        experiment: what is to be done.
        out: folder of the experiment.
        workers: graphs that run at once.
        resume: continue what is there.

    Raises:
        UsageError: the folder cannot be used, or the number of workers.
    """
    if not 1 <= workers <= LAG:
        raise UsageError(f'--workers {workers}: needs to be within 1..{LAG}')
    if not resume:
        check_new(out)
    elif not _may_be_begun(experiment, out):
        raise UsageError(f'--resume: {out}: holds no arm of {experiment.name}; leave --resume out')
    return {
        arm.name: SearchOptions(
            campaign=_campaign(experiment, arm, out), sampler=experiment.sampler,
            sampler_options=experiment.sampler_options, workers=workers,
            resume=resume and (out / arm.name / LEDGER_NAME).is_file(),
        )
        for arm in experiment.arms
    }


def _may_be_begun(experiment: Experiment, out: Path) -> bool:
    """Whether a folder holds arms of the experiment, if only one that was just to be begun."""
    arms = {arm.name for arm in experiment.arms}
    there = {path.name for path in out.iterdir()} if out.is_dir() else set()
    return bool(there) and (
        there <= arms or any((out / name / LEDGER_NAME).is_file() for name in arms)
    )


def arm_rows(experiment: Experiment, out: Path) -> dict[str, tuple[RunRow, ...]]:
    """The runs of every arm, by its name, out of the ledgers."""
    return {
        arm.name: read_ledger(out / arm.name / LEDGER_NAME).rows for arm in experiment.arms
    }


def check_paired(
    experiment: Experiment, rows: Mapping[str, tuple[RunRow, ...]]
) -> None:
    """See that the arms had the same scenes but for what an arm lays over.

    Raises:
        UsageError: two scenes of the same number differ elsewhere, so comparing them says nothing.
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
            for key, value in row.scene.items():
                if key not in free and value != other.scene[key]:
                    raise UsageError(
                        f'experiment {experiment.name}: run {row.index} has {key} '
                        f'{value} in {arm.name} and {other.scene[key]} in {first}, '
                        'though neither arm sets it; was the program changed between the arms?'
                    )


def _campaign(experiment: Experiment, arm: Arm, out: Path) -> CampaignOptions:
    return CampaignOptions(
        program=experiment.program, runs=experiment.runs, seed=experiment.seed,
        perception=arm.perception, out=out / arm.name, overrides=experiment.overrides,
        controller=arm.controller, laid_over=arm.laid_over, gains=arm.gains,
        specs=experiment.specs, images='none',
        arms=tuple(one.name for one in experiment.arms),
    )
