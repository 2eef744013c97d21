"""What a search is asked to do: a campaign, a sampler, workers, and when to stop."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.program_sampler import ProgramSampler
from taxinet_ros.campaign.samplers.lagged import LAG
from taxinet_ros.campaign.samplers.make import check_sampler
from taxinet_ros.campaign.samplers.option import split_options
from taxinet_ros.campaign.stop_rule import StopRule, parse_stop_rule
from taxinet_ros.core.errors import UsageError

DEFAULT_SAMPLER = 'active'
"""Chooses the scenes where neither a person nor the program names a sampler."""


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """One search.

    Attributes:
        campaign: scenes of which program, judged how, with which perception, and where to.
        sampler: word of the sampler that chooses the scenes; '' for the program's own, if it names
            one, else :data:`DEFAULT_SAMPLER`.
        sampler_options: its options as text, by name.
        workers: graphs that run at once.
        resume: continue what was interrupted.
        stop: stop before all runs are done, or None.
        budget_s: begin no run after so long [s of wall clock], or None.
    """

    campaign: CampaignOptions
    sampler: str
    sampler_options: Mapping[str, str] = field(default_factory=dict)
    workers: int = 1
    resume: bool = False
    stop: StopRule | None = None
    budget_s: float | None = None


def make_search_options(
    campaign: CampaignOptions, *, sampler: str | None, sampler_options: Iterable[str], workers: int,
    resume: bool, until: str | None, budget_min: float | None,
) -> SearchOptions:
    """Check what a person typed.

    Args:
        campaign: checked already.
        sampler: word of the sampler; None for the program's own or the default.
        sampler_options: ``key=value`` texts.
        workers: graphs that run at once.
        resume: continue what was interrupted.
        until: a stop rule as text, or None.
        budget_min: wall-clock time [min], or None.

    Raises:
        UsageError: one line on the first thing that is wrong.
    """
    if not 1 <= workers <= LAG:
        raise UsageError(f'--workers {workers}: needs to be within 1..{LAG}')
    if budget_min is not None and not budget_min > 0:
        raise UsageError(f'--budget {budget_min:g}: needs to be above 0 minutes')
    options = split_options(sampler_options)
    if sampler is not None:
        check_sampler(sampler, options)
    return SearchOptions(
        campaign=campaign, sampler=sampler or '', sampler_options=options,
        workers=workers, resume=resume, stop=parse_stop_rule(until) if until else None,
        budget_s=None if budget_min is None else 60 * budget_min,
    )


def with_sampler(
    options: SearchOptions, asked: ProgramSampler | None
) -> tuple[SearchOptions, str]:
    """The options with the sampler that is to be used, and a line on whose wish it is.

    Args:
        options: as a person gave them.
        asked: what the program asks for, or None.

    Returns:
        The options, and a line to print; '' where the program asks for nothing.

    Raises:
        UsageError: an option that the sampler does not have.
    """
    if options.sampler:
        line = f'sampler {options.sampler}, as asked; not the {asked.said} of {asked.place}' \
            if asked is not None else ''
        return options, line
    word = asked.word if asked is not None else DEFAULT_SAMPLER
    values = {**(asked.options if asked is not None else {}), **options.sampler_options}
    check_sampler(word, values)
    if asked is None:
        return replace(options, sampler=word), ''
    shown = ''.join(f' {name}={value}' for name, value in values.items())
    return (
        replace(options, sampler=word, sampler_options=values),
        f'sampler {word}{shown}, by {asked.said} of {asked.place}',
    )
