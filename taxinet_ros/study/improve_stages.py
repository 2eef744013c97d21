"""The stages of one round of ``taxinet improve``; paths are relative to its folder."""

from __future__ import annotations

from collections.abc import Sequence

from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.study.improve_options import FALSIFY, JUDGE, TRAIN, ImproveOptions
from taxinet_ros.study.stage import Stage
from taxinet_ros.study.stage_kinds import analysis_stage, campaign_stage, training_stage

START = 'start.safetensors'
"""The network to begin with: a copy, so that the folder holds all that the loop depends on."""


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
        analysis_stage(analyze_name(number), falsify_name(number), 1),
        _training(options, number, incumbent, campaigns),
        _campaign(options, incumbent_name(number), incumbent, 'random', seed),
        _campaign(options, candidate_name(number), candidate_weights(number), 'random', seed),
    )


def _campaign(
    options: ImproveOptions, name: str, weights: str, sampler: str, seed: int,
    also: tuple[str, ...] = (),
) -> Stage:
    return campaign_stage(
        name, options.program, sampler=sampler, seed=seed, runs=options.runs,
        workers=options.workers, weights=weights, outputs=also,
    )


def _training(
    options: ImproveOptions, number: int, incumbent: str, campaigns: Sequence[str]
) -> Stage:
    added = [word for portion in options.add for word in ('--add', portion)]
    for campaign in campaigns:
        added += ['--add-runs', f'{campaign}={options.counterexamples}']
    return training_stage(
        candidate_weights(number), options.base, '--learning-rate', f'{options.learning_rate:g}',
        '--start', incumbent, *['--varied'] * options.varied, *added,
        images=options.images, validation=options.validation,
        added=options.counterexamples * len(campaigns), epochs=options.epochs,
        seed=options.seed_of(number, TRAIN), workers=options.workers,
        inputs=(incumbent, *(f'{campaign}/{LEDGER_NAME}' for campaign in campaigns)),
        programs=[text.rpartition('=')[0] for text in options.add],
    )
