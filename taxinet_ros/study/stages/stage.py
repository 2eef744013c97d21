"""A stage of a study: a function of the package, with its inputs and outputs.

Also the kinds of stage shared by the case study and the improvement loop: campaigns, analyses,
trainings.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any

from taxinet_ros.core.perception.perception import GroundTruth, check_perception
from taxinet_ros.core.system import System
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.scenes.source import program_digest
from taxinet_ros.trials.experiment import find_experiment, read_experiment
from taxinet_ros.trials.options import GRAPH, check_engine
from taxinet_ros.trials.record.table import PARQUET_NAME
from taxinet_ros.version import __version__


class Resume(Enum):
    """How an interrupted stage is continued."""

    ANEW = 'anew'
    """Start from the beginning."""
    OPTION = 'option'
    """Go on in its folder, by the option ``resume``."""
    SAME = 'same'
    """Call it again."""
    REPLACE = 'replace'
    """Start from the beginning and replace earlier results."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A call of the function of a command. Paths are relative to the folder in which it is made.

    Attributes:
        name: name of the stage and of its folder.
        command: the command of the same function.
        argument: its argument, or ''.
        options: its options, by name.
        hints: options that do not affect the result, such as ``workers``.
        runs: value of the option ``runs``, or 0 if it has none. A stage started with fewer
            continues.
        inputs: files of earlier stages.
        wants: optional further inputs.
        programs: Scenic programs, as words or paths.
        experiment: word or file of the experiment, or ''.
        perception: a network from outside the study, or ''.
        outputs: its output files.
        resume: how it is continued.
        accepts: exit codes that mean done: 1 if a run violates its formula; 4 if a run had an
            infrastructure error, which is counted and shown.
        needs_failures: campaign without whose failed runs there is nothing to do, or ''.
        needs: the input without which there is nothing to do, or ''; its stage writes none if it
            found nothing.
        optional: whether the study goes on without it if it is refused; it is tried again by the
            next sitting.
    """

    name: str
    command: str
    argument: str = ''
    options: Mapping[str, Any]
    outputs: tuple[str, ...]
    hints: Mapping[str, Any] = field(default_factory=dict)
    runs: int = 0
    inputs: tuple[str, ...] = ()
    wants: tuple[str, ...] = ()
    programs: tuple[str, ...] = ()
    experiment: str = ''
    perception: str = ''
    resume: Resume = Resume.ANEW
    accepts: tuple[int, ...] = (0,)
    needs_failures: str = ''
    needs: str = ''
    optional: bool = False

    def arguments(self, *, resume: bool = False) -> dict[str, Any]:
        """All options of the call."""
        again = {'resume': True} if resume and self.resume is Resume.OPTION else {}
        return {**self.options, **({'runs': self.runs} if self.runs else {}), **self.hints, **again}

    def words(self, *, resume: bool = False) -> tuple[str, ...]:
        """Arguments of ``taxinet`` that do the same by hand."""
        options = (word for option in self.arguments(resume=resume).items()
                   for word in _option_words(*option))
        return (self.command, *filter(None, [self.argument]), *options)

    def ready(self, out: Path) -> bool:
        """Whether its inputs from other stages exist."""
        return all((out / name).is_file() for name in self.inputs if name != self.needs)

    def identity(self, out: Path) -> str:
        """Digest of everything that its result depends on, except the number of runs.

        Raises:
            UsageError: a program, experiment or network cannot be read.
            OSError: an input cannot be read.
        """
        return _digest(self._ingredients(out))

    def key(self, out: Path) -> str:
        """Digest of everything that its result depends on. Raises as :meth:`identity`."""
        return _digest({**self._ingredients(out), 'runs': self.runs})

    def _ingredients(self, out: Path) -> dict[str, Any]:
        found: dict[str, Any] = {
            'command': self.command, 'argument': self.argument, 'options': self.options,
            'version': __version__,
            'inputs': {
                name: file_sha256(out / name) for name in (*self.inputs, *self.wants)
                if (name in self.inputs and name != self.needs) or (out / name).is_file()
            },
            'programs': {
                word: program_digest(word) for word in self.programs if word not in self.inputs
            },
        }
        if self.experiment:
            path = find_experiment(self.experiment)
            found['experiment'] = [file_sha256(path), program_digest(read_experiment(path).program)]
        if self.perception:
            found['perception'] = check_perception(self.perception)
        return found

    def results(self, out: Path) -> dict[str, str]:
        """Digests of its existing outputs by name."""
        return {name: file_sha256(out / name) for name in self.outputs if (out / name).is_file()}


def _digest(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True, default=str).encode()).hexdigest()


def _option_words(name: str, value: Any) -> Iterable[str]:
    option = f'--{name.replace("_", "-")}'
    if isinstance(value, bool):
        return [option] * value
    values = value if isinstance(value, list | tuple) else [value]
    return [word for one in values for word in (option, str(one))]


_BATCH = 64
_ENGINED = ('falsify', 'experiment', 'shrink')
"""Commands that make runs by an engine."""


def with_engine(
    found: Iterable[Stage], engine: str, audit: str | None, cluster: str = ''
) -> tuple[Stage, ...]:
    """Stages whose campaigns are run by an engine or a cluster, which do not affect results.

    Args:
        found: the stages.
        engine: what makes the runs, see :class:`.CampaignOptions`.
        audit: share of the runs to audit as text, see :func:`.check_engine`.
        cluster: result of :func:`.pool.check_cluster`, or '' for worker processes here.

    Raises:
        UsageError: unknown engine, or a bad share.
    """
    check_engine(engine, audit, System(perception=GroundTruth.word))
    more = {
        **({} if engine == GRAPH else {'engine': engine}),
        **({} if audit is None else {'audit': audit}),
    }
    return tuple(
        replace(stage, hints={**({'cluster': cluster} if cluster else stage.hints), **more})
        if stage.command in _ENGINED else stage
        for stage in found
    )


def campaign_stage(
    name: str, program: str, *, sampler: str, seed: int, runs: int, workers: int, weights: str = '',
    perception: str = '', needs: str = '', sampler_options: Sequence[str] = (),
) -> Stage:
    """Stage with a campaign of a network, without pictures in the bags.

    Args:
        name: name of the stage.
        program: scenario program.
        sampler: sampler of its scenes.
        seed: seed of the sampler.
        runs: number of runs.
        workers: number of concurrent processes.
        weights: weights file of an earlier stage; alternative to ``perception``.
        perception: word or file of a network from outside the study.
        needs: the weights, if they may be missing because there was nothing to learn.
        sampler_options: options of the sampler, ``KEY=VALUE``.
    """
    return Stage(
        name=name, runs=runs, hints={'workers': workers}, command='falsify', argument=program,
        options={
            'sampler': sampler, 'sampler_option': sampler_options, 'seed': seed,
            'perception': perception or weights, 'images': 'none', 'out': name,
        },
        inputs=() if perception else (weights,), programs=(program,), perception=perception,
        outputs=(f'{name}/{PARQUET_NAME}',), needs=needs,
        # 1 if a run violates its formula, 4 if a run has an infrastructure error.
        resume=Resume.OPTION, accepts=(0, 1, 4),
    )


def analysis_stage(name: str, campaign: str, **more: Any) -> Stage:
    """Stage that analyses the failures of a campaign; ``more`` are other attributes."""
    return Stage(**{
        'name': name, 'command': 'analyze', 'argument': campaign, 'options': {'out': name},
        'inputs': (f'{campaign}/{PARQUET_NAME}',), 'resume': Resume.REPLACE,
        'outputs': (f'{name}/analysis.json', f'{name}/report.html'), **more,
    })


def localisation_stage(name: str, campaign: str, *, runs: int, workers: int, **more: Any) -> Stage:
    """Stage that drives failed runs again with perfect estimates; ``more`` as above."""
    return Stage(**{
        'name': name, 'command': 'localize', 'argument': campaign, 'options': {'out': name},
        'runs': runs, 'hints': {'workers': workers}, 'inputs': (f'{campaign}/{PARQUET_NAME}',),
        'outputs': (f'{name}/localize.json', f'{name}/localize.parquet'), 'resume': Resume.SAME,
        **more,
    })


def training_stage(
    weights: str, program: str, *, images: int, validation: int, epochs: int, seed: int,
    workers: int, inputs: Sequence[str] = (), programs: Sequence[str] = (), needs: str = '',
    **more: Any,
) -> Stage:
    """Stage that trains a network.

    Args:
        weights: file to write, in the folder that names the stage.
        program: program of the training pictures.
        images: number of training pictures of the program.
        validation: number of additional held-out pictures.
        epochs: number of passes over all pictures.
        seed: seed of everything random.
        workers: number of concurrent processes.
        inputs: files of earlier stages.
        programs: programs in ``more``.
        needs: the one that may be missing because nothing was learned, or ''.
        more: further options of the training.
    """
    return Stage(
        name=Path(weights).parts[0], inputs=tuple(inputs), needs=needs,
        programs=tuple(dict.fromkeys([program, *programs])), command='train', argument=program,
        options={
            'images': images, 'validation': validation, 'epochs': epochs,
            'batch': min(_BATCH, images), 'seed': seed, **more, 'out': weights,
        },
        hints={'workers': workers},
        outputs=(weights, str(Path(weights).with_suffix('.json'))), resume=Resume.OPTION,
    )
