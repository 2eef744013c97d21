"""What a study has found, in sentences; every figure in them is computed from its runs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pandas as pd

from taxinet_ros.study.claim import Verdict
from taxinet_ros.study.paper import PAPER_RUNS
from taxinet_ros.study.study_lines import about

if TYPE_CHECKING:
    from taxinet_ros.study.study_sections import StudyFindings

OTHER_WORLD = (
    'Why figures differ: the pictures here come from our own renderer and not from X-Plane, the '
    'networks and the steering law are our own, and the original network was trained on a narrow '
    'world of our choosing, since what Boeing trained theirs on is not published. Nothing was '
    "tuned towards the paper's figures. What can be compared is the kind: which of two networks "
    'does better, and where they fail.'
)


def study_summary(found: StudyFindings) -> tuple[str, ...]:
    """The findings, the most important first."""
    return (*_incomplete(found), *_rates(found), *_counts(found), *_cost(found))


def percent(value: float, low: float, high: float) -> str:
    """A share with its interval, such as ``49.9 % (48.3-51.5)``."""
    return f'{100 * value:.1f} % ({100 * low:.1f}-{100 * high:.1f})'


def _incomplete(found: StudyFindings) -> Iterator[str]:
    if found.stages.empty:
        return
    todo = found.stages[~found.stages['done']]['stage'].tolist()
    if todo:
        done = len(found.stages) - len(todo)
        yield f'{done} of {len(found.stages)} stages are done; the next is {todo[0]}.'


def _rates(found: StudyFindings) -> Iterator[str]:
    frame = found.networks
    runs = frame['runs']
    many = f'{runs.min():,}' if runs.min() == runs.max() else f'{runs.min():,} to {runs.max():,}'
    yield (
        f'{len(frame)} {"network" if len(frame) == 1 else "networks"}, judged on {many} runs of '
        f'{frame["program"].iloc[0]}, seed {frame["seed"].iloc[0]}, the same scenes for each '
        '(95 % Clopper-Pearson intervals).'
    )
    if found.config.scale < 1 or runs.min() < PAPER_RUNS:
        yield (
            f"This is a smaller study than the paper's (scale {found.config.scale:g}, "
            f'{found.config.images:,} images a network; the paper has about {PAPER_RUNS:,} runs '
            'each): read the intervals, not the figures.'
        )
    for _, line in frame.iterrows():
        yield _network(line)


def _network(line: pd.Series[Any]) -> str:
    words = [
        f'satisfied {percent(*(line[f"satisfied{end}"] for end in ("", "_low", "_high")))}'
        + _paper(line['paper_satisfied']),
        f'off the runway {percent(*(line[f"off_runway{end}"] for end in ("", "_low", "_high")))}'
        + _paper(line['paper_off_runway']),
    ]
    broken = int(line['without_verdict'])
    runs = '1 run' if broken == 1 else f'{broken} runs'
    more = f' ({runs} without a verdict, in no rate)' if broken else ''
    return f'{line["network"]}: {", ".join(words)}{more}.'


def _paper(value: float) -> str:
    return '' if pd.isna(value) else f', the paper {100 * value:g} %'


def _counts(found: StudyFindings) -> Iterator[str]:
    if not found.claims:
        return
    counts = {
        verdict: sum(claim.verdict is verdict for claim in found.claims) for verdict in Verdict
    }
    words = ', '.join(f'{count} {verdict.value}' for verdict, count in counts.items())
    yield f'Of {len(found.claims)} statements of the paper: {words}.'


def _cost(found: StudyFindings) -> Iterator[str]:
    if found.stages.empty:
        return
    done = found.stages[found.stages['done']]
    if done.empty:
        return
    least = 'at least ' if done['at_least'].any() else ''
    cores = done['cores'].dropna().unique()
    on = f' on {"/".join(str(int(number)) for number in sorted(cores))} cores' if len(cores) else ''
    yield f'The stages that are done took {least}{about(done["wall_s"].sum())}{on}.'
