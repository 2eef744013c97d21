"""The stages of one round of ``taxinet improve``; paths are relative to its folder."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.campaign.table import PARQUET_NAME
from taxinet_ros.study.improve_options import FALSIFY, JUDGE, TRAIN, ImproveOptions
from taxinet_ros.study.stage import Kind, Resume, Stage

START = 'start.safetensors'
"""The network to begin with: a copy, so that the folder holds all that the loop depends on."""

_BATCH = 64
_RENDERING = 2
"""A rendered picture costs about as much time as so many looks at one in training."""
_RUN_DONE = (0, 1, 4)


def falsify_name(number: int) -> str:
    """Folder of the campaign that looks for failures in a round."""
    return f'round-{number}-falsify'


def incumbent_name(number: int) -> str:
    """Folder of the incumbent's runs on the scenes that judge."""
    return f'round-{number}-incumbent'


def candidate_name(number: int) -> str:
    """Folder of the candidate's runs on the same scenes."""
    return f'round-{number}-candidate'


def analyze_name(number: int) -> str:
    """Folder of what the failures have in common."""
    return f'round-{number}-analyze'


def candidate_weights(number: int) -> str:
    """Weights file that a round trains."""
    return f'round-{number}-train/candidate.safetensors'


def search_stage(options: ImproveOptions, number: int, incumbent: str) -> Stage:
    """Look for failures of the incumbent."""
    return _campaign(
        options, falsify_name(number), incumbent, options.sampler,
        options.seed_of(number, FALSIFY), also=(f'{falsify_name(number)}/{LEDGER_NAME}',),
    )


def round_stages(
    options: ImproveOptions, number: int, incumbent: str, campaigns: Sequence[str]
) -> tuple[Stage, ...]:
    """Group the failures, learn from them, and run both networks on scenes new to both.

    Args:
        options: of the loop.
        number: of the round, from 1.
        incumbent: weights file of the best network so far.
        campaigns: folders with failed runs, this round's last.
    """
    seed = options.seed_of(number, JUDGE)
    return (
        _analysis(number),
        _training(options, number, incumbent, campaigns),
        _campaign(options, incumbent_name(number), incumbent, 'random', seed),
        _campaign(options, candidate_name(number), candidate_weights(number), 'random', seed),
    )


def _campaign(
    options: ImproveOptions, name: str, weights: str, sampler: str, seed: int,
    also: tuple[str, ...] = (),
) -> Stage:
    return Stage(
        name=name, runs=options.runs, hints=_workers(options), inputs=(weights,),
        words=('falsify', options.program, '--sampler', sampler, '--seed', str(seed),
               '--perception', weights, '--images', 'none', '--out', name),
        programs=(options.program,), outputs=(f'{name}/{PARQUET_NAME}', *also), kind=Kind.RUNS,
        amount=options.runs, resume=Resume.OPTION, accepts=_RUN_DONE,
    )


def _analysis(number: int) -> Stage:
    campaign, name = falsify_name(number), analyze_name(number)
    return Stage(
        name=name, words=('analyze', campaign, '--out', name),
        inputs=(f'{campaign}/{PARQUET_NAME}',),
        outputs=(f'{name}/analysis.json', f'{name}/report.html'), kind=Kind.REPORT, amount=1,
        resume=Resume.REPLACE,
    )


def _training(
    options: ImproveOptions, number: int, incumbent: str, campaigns: Sequence[str]
) -> Stage:
    weights = candidate_weights(number)
    added = [word for portion in options.add for word in ('--add', portion)]
    for campaign in campaigns:
        added += ['--add-runs', f'{campaign}={options.counterexamples}']
    images = options.images + options.counterexamples * len(campaigns)
    return Stage(
        name=Path(weights).parts[0],
        words=('train', options.base, '--images', str(options.images),
               '--validation', str(options.validation), '--epochs', str(options.epochs),
               '--batch', str(min(_BATCH, options.images)),
               '--learning-rate', f'{options.learning_rate:g}',
               '--seed', str(options.seed_of(number, TRAIN)),
               '--start', incumbent, *['--varied'] * options.varied, *added, '--out', weights),
        hints=_workers(options),
        inputs=(incumbent, *(f'{campaign}/{LEDGER_NAME}' for campaign in campaigns)),
        programs=(options.base, *(text.rpartition('=')[0] for text in options.add)),
        outputs=(weights, str(Path(weights).with_suffix('.json'))), kind=Kind.LOOKS,
        amount=images * (_RENDERING + options.epochs),
    )


def _workers(options: ImproveOptions) -> tuple[str, ...]:
    return ('--workers', str(options.workers))
