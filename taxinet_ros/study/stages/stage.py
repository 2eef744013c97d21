"""A stage of a study: one ``taxinet`` command, what it needs, and what it leaves behind.

Below it the kinds of stage that both the case study and ``taxinet improve`` are made of:
campaigns, analyses, trainings.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from taxinet_ros.campaign.experiment import find_experiment, read_experiment
from taxinet_ros.campaign.record.table import PARQUET_NAME
from taxinet_ros.campaign.scenes.programs import find_program, program_digest
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.version import __version__


class Resume(Enum):
    """How a stage that was interrupted goes on."""

    ANEW = 'anew'
    """From its beginning."""
    OPTION = 'option'
    """With ``--resume``."""
    SAME = 'same'
    """By the same command."""
    REPLACE = 'replace'
    """From its beginning, in place of what it has left there before."""


class Kind(Enum):
    """What a stage spends its time with, and so how long it takes."""

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
    """One command of a case study. Paths are relative to the study's folder, where it is run.

    Attributes:
        name: of the stage and of its folder.
        words: the command, without ``taxinet``, without how many runs, and without ``hints``.
        hints: options that change nothing in the result, as ``--workers``.
        runs: number of runs, the option ``--runs``; 0 where it has none. What was begun with fewer
            goes on.
        inputs: files of earlier stages.
        wants: further ones, that may be missing.
        programs: Scenic programs, as words or paths.
        experiment: word or file of the experiment that it is, or ''.
        perception: a network from outside the study, or ''.
        outputs: files that it leaves behind when it is done.
        kind, amount: of its work.
        resume: how it goes on.
        accepts: exit codes that mean that it is done. A run that violates its formula makes 1, and
            4 means that the bench broke some run, which is counted and shown.
        needs_failures: a campaign without whose failed runs there is nothing to do, or ''.
        needs: one of the inputs, without which there is nothing to do, or '': its stage leaves none
            where it has found nothing.
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

    def command(self, *, resume: bool = False) -> tuple[str, ...]:
        """The words after ``taxinet``."""
        again = ('--resume',) if resume and self.resume is Resume.OPTION else ()
        runs = ('--runs', str(self.runs)) if self.runs else ()
        return (*self.words, *runs, *self.hints, *again)

    def ready(self, out: Path) -> bool:
        """Whether what it needs of other stages is there."""
        return all((out / name).is_file() for name in self.inputs if name != self.needs)

    def identity(self, out: Path) -> str:
        """Digest of all that its result depends on, but for the number of runs.

        Raises:
            UsageError: a program, experiment or network cannot be read.
            OSError: an input cannot.
        """
        return _digest(self._ingredients(out))

    def key(self, out: Path) -> str:
        """Digest of all that its result depends on. Raises as :meth:`identity`."""
        return _digest({**self._ingredients(out), 'runs': self.runs})

    def _ingredients(self, out: Path) -> dict[str, Any]:
        found: dict[str, Any] = {
            'words': self.words, 'version': __version__,
            'inputs': {
                name: file_sha256(out / name) for name in (*self.inputs, *self.wants)
                if (name in self.inputs and name != self.needs) or (out / name).is_file()
            },
            'programs': {
                word: program_digest(out / word if word in self.inputs else find_program(word))
                for word in self.programs if word != self.needs or (out / word).is_file()
            },
        }
        if self.experiment:
            path = find_experiment(self.experiment)
            program = find_program(read_experiment(path).program)
            found['experiment'] = [file_sha256(path), program_digest(program)]
        if self.perception:
            found['perception'] = check_perception(self.perception)
        return found

    def results(self, out: Path) -> dict[str, str]:
        """Digests of its outputs by name; of those that are there."""
        return {name: file_sha256(out / name) for name in self.outputs if (out / name).is_file()}


def _digest(values: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


_BATCH = 64
_RENDERING = 2
"""A rendered picture costs about as much time as so many looks at one in training."""


def workers_option(workers: int) -> tuple[str, ...]:
    """The option that says how many processes work at once, on which nothing else depends."""
    return ('--workers', str(workers))


def campaign_stage(
    name: str, program: str, *, sampler: str, seed: int, runs: int, workers: int, weights: str = '',
    perception: str = '', outputs: Sequence[str] = (), needs: str = '',
) -> Stage:
    """Runs of a network, chosen by a sampler, without pictures.

    Args:
        name: of the stage.
        program: whose scenes they are.
        sampler: that chooses among them.
        seed: of it.
        runs: how many.
        workers: processes that work at once.
        weights: file of an earlier stage, or ``perception``.
        perception: word or file of a network from outside.
        outputs: files beside the table.
        needs: the weights, where they may not be there because there was nothing to learn.
    """
    return Stage(
        name=name, runs=runs, hints=workers_option(workers),
        words=('falsify', program, '--sampler', sampler, '--seed', str(seed),
               '--perception', perception or weights, '--images', 'none', '--out', name),
        inputs=() if perception else (weights,), programs=(program,), perception=perception,
        outputs=(f'{name}/{PARQUET_NAME}', *outputs), kind=Kind.RUNS, amount=runs, needs=needs,
        # A run that violates its formula makes 1, one that the bench broke 4.
        resume=Resume.OPTION, accepts=(0, 1, 4),
    )


def analysis_stage(name: str, campaign: str, amount: float) -> Stage:
    """What the failures of a campaign have in common."""
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
    """The training of a network.

    Args:
        weights: file to write, in the folder that names the stage.
        program: whose pictures it learns.
        more: further words of the command.
        images: pictures of the program to learn.
        validation: further ones to hold back.
        added: pictures that ``more`` adds.
        epochs: times that every picture is seen.
        seed: of everything random.
        workers: processes that work at once.
        inputs: files of earlier stages.
        programs: those of ``more``.
        needs: the one of them that may not be there because nothing was learned, or ''.
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
