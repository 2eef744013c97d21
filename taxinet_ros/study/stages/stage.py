"""A stage of a study: one ``taxinet`` command with its inputs and outputs.

Also the kinds of stage shared by the case study and ``taxinet improve``: campaigns, analyses,
trainings.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.experiment import find_experiment, read_experiment
from taxinet_ros.campaign.options import GRAPH, check_engine
from taxinet_ros.campaign.record.table import PARQUET_NAME
from taxinet_ros.campaign.scenes.source import program_digest
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.perception.perception import GroundTruth, check_perception
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.version import __version__


class Resume(Enum):
    """How an interrupted stage is continued."""

    ANEW = 'anew'
    """Start from the beginning."""
    OPTION = 'option'
    """Add ``--resume``."""
    SAME = 'same'
    """Repeat the same command."""
    REPLACE = 'replace'
    """Start from the beginning and replace earlier results."""


class Kind(Enum):
    """Kind of work of a stage, which determines its duration."""

    RUNS = 'runs'
    """Amount: runs of 30 s on the graph."""
    TRIALS = 'trials'
    """Amount: runs without a graph."""
    LOOKS = 'looks'
    """Amount: pictures times epochs; rendering one counts as a few."""
    REPORT = 'report'
    """Amount: 1."""


@dataclass(frozen=True, kw_only=True)
class Stage:
    """One command of a case study. Paths are relative to the study's folder, its working directory.

    Attributes:
        name: name of the stage and of its folder.
        words: the command, without ``taxinet``, ``--runs`` and ``hints``.
        hints: options that do not affect the result, such as ``--workers``.
        runs: value of ``--runs``, or 0 if it has none. A stage started with fewer continues.
        inputs: files of earlier stages.
        wants: optional further inputs.
        programs: Scenic programs, as words or paths.
        experiment: word or file of the experiment, or ''.
        perception: a network from outside the study, or ''.
        outputs: its output files.
        kind, amount: kind and amount of its work.
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
    words: tuple[str, ...]
    outputs: tuple[str, ...]
    kind: Kind
    amount: float
    hints: tuple[str, ...] = ()
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

    def command(self, *, resume: bool = False) -> tuple[str, ...]:
        """Arguments of ``taxinet``."""
        again = ('--resume',) if resume and self.resume is Resume.OPTION else ()
        runs = ('--runs', str(self.runs)) if self.runs else ()
        return (*self.words, *runs, *self.hints, *again)

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
            'words': self.words, 'version': __version__,
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
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


_BATCH = 64
_RENDERING = 2
"""Rendering time of a picture, in training passes over one picture."""


def workers_option(workers: int) -> tuple[str, ...]:
    """Option for the number of concurrent processes, which does not affect results."""
    return ('--workers', str(workers))


def with_engine(
    found: Iterable[Stage], engine: str, audit: str | None, cluster: str = ''
) -> tuple[Stage, ...]:
    """Stages whose campaigns are run by an engine or a cluster, which do not affect results.

    Args:
        found: the stages.
        engine: what makes the runs, see :class:`.CampaignOptions`.
        audit: share of the runs to audit as text, see :func:`.check_engine`.
        cluster: result of :func:`.connection.check_cluster`, or '' for worker processes here.

    Raises:
        UsageError: unknown engine, or a bad share.
    """
    check_engine(engine, audit, GroundTruth.word, STEERING, {})
    words = (
        *(() if engine == GRAPH else ('--engine', engine)),
        *(() if audit is None else ('--audit', audit)),
    )
    return tuple(
        replace(stage, hints=(*(('--cluster', cluster) if cluster else stage.hints), *words))
        if stage.kind is Kind.RUNS else stage
        for stage in found
    )


def campaign_stage(
    name: str, program: str, *, sampler: str, seed: int, runs: int, workers: int, weights: str = '',
    perception: str = '', outputs: Sequence[str] = (), needs: str = '',
    sampler_options: Sequence[str] = (),
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
        outputs: files written in addition to the table.
        needs: the weights, if they may be missing because there was nothing to learn.
        sampler_options: options of the sampler, ``KEY=VALUE``.
    """
    chosen = [word for option in sampler_options for word in ('--sampler-option', option)]
    return Stage(
        name=name, runs=runs, hints=workers_option(workers),
        words=('falsify', program, '--sampler', sampler, *chosen, '--seed', str(seed),
               '--perception', perception or weights, '--images', 'none', '--out', name),
        inputs=() if perception else (weights,), programs=(program,), perception=perception,
        outputs=(f'{name}/{PARQUET_NAME}', *outputs), kind=Kind.RUNS, amount=runs, needs=needs,
        # 1 if a run violates its formula, 4 if a run has an infrastructure error.
        resume=Resume.OPTION, accepts=(0, 1, 4),
    )


def analysis_stage(name: str, campaign: str, amount: float) -> Stage:
    """Stage that analyses the failures of a campaign."""
    return Stage(
        name=name, words=('analyze', campaign, '--out', name),
        inputs=(f'{campaign}/{PARQUET_NAME}',),
        outputs=(f'{name}/analysis.json', f'{name}/report.html'), kind=Kind.REPORT, amount=amount,
        resume=Resume.REPLACE,
    )


def training_stage(
    weights: str, program: str, *more: str, images: int, validation: int, added: int, epochs: int,
    seed: int, workers: int, inputs: Sequence[str] = (), programs: Sequence[str] = (),
    needs: str = '',
) -> Stage:
    """Stage that trains a network.

    Args:
        weights: file to write, in the folder that names the stage.
        program: program of the training pictures.
        more: further words of the command.
        images: number of training pictures of the program.
        validation: number of additional held-out pictures.
        added: number of pictures added by ``more``.
        epochs: number of passes over all pictures.
        seed: seed of everything random.
        workers: number of concurrent processes.
        inputs: files of earlier stages.
        programs: programs in ``more``.
        needs: the one that may be missing because nothing was learned, or ''.
    """
    return Stage(
        name=Path(weights).parts[0], inputs=tuple(inputs), needs=needs,
        programs=tuple(dict.fromkeys([program, *programs])),
        words=('train', program, '--images', str(images), '--validation', str(validation),
               '--epochs', str(epochs), '--batch', str(min(_BATCH, images)), '--seed', str(seed),
               *more, '--out', weights),
        hints=workers_option(workers),
        outputs=(weights, str(Path(weights).with_suffix('.json'))), kind=Kind.LOOKS,
        amount=(images + added + validation) * _RENDERING + (images + added) * epochs,
    )
