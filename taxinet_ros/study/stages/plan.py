"""The stages of the case study, in the paper's order: falsify, debug, retrain, learn, iterate."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import typed
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.run import read_options
from taxinet_ros.study.stages.stage import (
    Resume,
    Stage,
    analysis_stage,
    campaign_stage,
    localisation_stage,
    training_stage,
)

COMMAND = 'case-study'
"""The command, by which a record names its study."""
ORIGINAL, GENERIC, HALTON, SPECIALISED = 'original', 'generic', 'halton', 'specialised'
ITERATIVE = ('iterative-generic', 'iterative-crossing', 'iterative-learned')
BEST = 'best'
NETWORKS = (ORIGINAL, GENERIC, HALTON, SPECIALISED, *ITERATIVE, BEST)
"""Names of the networks; their campaigns are ``evaluate-<name>``, except the original's."""

PAPER_RULE = 'ce-verifai'
"""What a study calls the sampler ``ce`` with the paper's learning rule."""
FALSIFY, ANALYZE, LOCALIZE, REPORT = (
    'falsify-original', 'analyze-original', 'localize-original', 'report'
)


def read_study(out: Path, option: str) -> StudyConfig:
    """The configuration of the case study in a folder; arguments and errors as of read_options."""
    return typed(StudyConfig, read_options(out, COMMAND, option))


def campaign_of(network: str) -> str:
    """Folder of the campaign that evaluates a network."""
    return FALSIFY if network == ORIGINAL else f'evaluate-{network}'


def weights_of(network: str) -> str:
    """Weights file of a network trained in the study."""
    return f'train-{network}/{network}.safetensors'


def search_of(sampler: str, seed: int) -> str:
    """Folder of a search for the generic network's failures."""
    return f'learn-{sampler}-{seed}'


def learned_program(config: StudyConfig) -> str:
    """Program learned by the first search, whose pictures are added for further training.

    By the paper's rule, or by the first sampler of a study without that rule.
    """
    sampler = PAPER_RULE if PAPER_RULE in config.samplers else config.samplers[0]
    return f'{search_of(sampler, config.learning_seeds[0])}/learned.scenic'


def stages(config: StudyConfig) -> tuple[Stage, ...]:
    """All stages of a study, each after the stages whose files it needs."""
    found = [_training(config, ORIGINAL, config.original), _evaluation(config, ORIGINAL)]
    found += [*_debugging(config), *_retraining(config)]
    found += [*_learning(config), *_iteration(config)]
    if config.best:
        found.append(_evaluation(config, BEST, config.best))
    everything = tuple(name for stage in found for name in stage.outputs)
    found.append(Stage(
        name=REPORT, command='case-study', options={'report_only': True, 'out': '.'},
        wants=everything,
        outputs=(f'{REPORT}/case_study.html', f'{REPORT}/case_study.json',
                 f'{REPORT}/networks.parquet'),
        resume=Resume.REPLACE,
    ))
    return tuple(found)


def stages_until(found: Sequence[Stage], name: str) -> tuple[Stage, ...]:
    """The stages up to one of them.

    Raises:
        UsageError: there is no stage of that name.
    """
    names = [stage.name for stage in found]
    if name not in names:
        raise UsageError(f'until {name}: no such stage; known: {", ".join(names)}')
    return tuple(found[:names.index(name) + 1])


def _debugging(config: StudyConfig) -> Iterator[Stage]:
    yield analysis_stage(ANALYZE, FALSIFY)
    yield localisation_stage(
        LOCALIZE, FALSIFY, runs=config.localized, workers=config.workers, needs_failures=FALSIFY,
    )
    weights = weights_of(ORIGINAL)
    for word, runs in config.experiments.items():
        name = f'experiment-{Path(word).stem}'
        yield Stage(
            name=name, command='experiment', argument=word,
            options={'perception': weights, 'out': name}, runs=runs,
            hints={'workers': config.workers}, inputs=(weights,), experiment=word,
            outputs=(f'{name}/experiment.json', f'{name}/pairs.parquet'), accepts=(0, 4),
            resume=Resume.OPTION,
        )


def _retraining(config: StudyConfig) -> Iterator[Stage]:
    yield _training(config, GENERIC, config.generic)
    yield _training(config, HALTON, config.generic, sampler='halton')
    yield _training(
        config, SPECIALISED, config.specialised, validation_program=config.generic)
    for network in (GENERIC, HALTON, SPECIALISED):
        yield _evaluation(config, network)


def _learning(config: StudyConfig) -> Iterator[Stage]:
    for sampler in config.samplers:
        for seed in config.learning_seeds:
            yield campaign_stage(
                search_of(sampler, seed), config.learning_program, seed=seed,
                sampler='ce' if sampler == PAPER_RULE else sampler,
                sampler_options=('rule=verifai',) if sampler == PAPER_RULE else (),
                runs=config.learning_runs, workers=config.workers, weights=weights_of(GENERIC),
            )


def _iteration(config: StudyConfig) -> Iterator[Stage]:
    programs = (config.generic, config.crossing, learned_program(config))
    for network, program in zip(ITERATIVE, programs, strict=True):
        # The same seed, for the images of the generic network and additional ones.
        yield _training(
            config, network, config.generic, epochs=config.further_epochs, added=program,
            start=weights_of(GENERIC), add=[f'{program}={config.added}'],
        )
    for network in ITERATIVE:
        yield _evaluation(config, network)


def _training(
    config: StudyConfig, network: str, program: str, *, epochs: int = 0, added: str = '',
    **more: Any,
) -> Stage:
    """Training of a network; further training of the generic one if images are added."""
    learned = added if added == learned_program(config) else ''
    inputs = [weights_of(GENERIC)] * bool(added) + [learned] * bool(learned)
    others = [added] * bool(added) + [config.generic] * ('validation_program' in more)
    return training_stage(
        weights_of(network), program, images=config.images, validation=config.validation,
        epochs=epochs or config.epochs, seed=config.training_seed, workers=config.workers,
        inputs=inputs, programs=others, needs=learned, **more,
    )


def _evaluation(config: StudyConfig, network: str, perception: str = '') -> Stage:
    return campaign_stage(
        campaign_of(network), config.program, sampler='random', seed=config.seed, runs=config.runs,
        workers=config.workers, weights=weights_of(network), perception=perception,
        needs=weights_of(network) if network == ITERATIVE[2] else '',
    )
