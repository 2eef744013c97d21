"""Which perception a search is about, and its timing, where it is the graph that decides them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import RunResult
from taxinet_ros.core.timing import NOT_REPRODUCIBLE, is_free, timing_words

KEYS = ('perception', 'perception_sha256', 'timing')
"""The facts that say it; all are empty until the graph has answered."""


def met(out: Path, facts: Mapping[str, Any], result: RunResult) -> dict[str, str]:
    """What an answer adds to the facts: who perceived, if that was not known before.

    Args:
        out: the campaign's folder.
        facts: of the campaign.
        result: the answer. Where the run broke before a perception was ready it says nothing.

    Raises:
        UsageError: another perception answered than the campaign was begun with, or its answers
            take effect at another time.
    """
    found = dict(zip(KEYS, (result.perception, result.fingerprint, result.timing), strict=True))
    if is_free(result.timing):
        raise UsageError(
            f'the graph lets runs go free, and a search goes by verdicts that come again: '
            f'{NOT_REPRODUCIBLE}; start the simulator with lockstep:=true, or leave the sampler out'
        )
    if not result.perception:
        return {}
    if not facts['perception']:
        return found
    if facts['timing'] != result.timing:
        raise UsageError(
            f'{out} was begun with {timing_words(facts["timing"])}, but the graph has '
            f'{timing_words(result.timing)}; start the one it was begun with, or name another --out'
        )
    if _same(facts, found):
        return {}
    raise UsageError(
        f'{out} was begun with perception {_words(facts)}, but the graph has {_words(found)}; '
        'start the one it was begun with, or name another --out'
    )


def _same(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two are the same network whatever it is called, or both the truth."""
    if one['perception_sha256'] or other['perception_sha256']:
        return bool(one['perception_sha256'] == other['perception_sha256'])
    return bool(one['perception'] == other['perception'])


def _words(facts: Mapping[str, Any]) -> str:
    sha256 = facts['perception_sha256']
    return f'{facts["perception"]} (sha256 {sha256[:12]}…)' if sha256 else facts['perception']
