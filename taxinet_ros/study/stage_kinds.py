"""The stages that both the case study and ``taxinet improve`` are made of."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from taxinet_ros.campaign.table import PARQUET_NAME
from taxinet_ros.study.stage import Kind, Resume, Stage

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
