"""What a bag says of its own run: enough to run it once more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bag.decode import decoded_messages
from taxinet_ros.bag.errors import BagEmpty, BagForeign, several_runs
from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.message_values import scenario_of
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import RunRequest
from taxinet_ros.core.steering import SteeringGains
from taxinet_ros.core.stop_on import parse_stop_on
from taxinet_ros.core.timing import AT_ONCE, Timing, parse_timing

_HEAD = ('/scenario', '/node_status', '/clock')


@dataclass(frozen=True, kw_only=True)
class RecordedRun:
    """The run that a bag holds.

    Attributes:
        request: what was asked of the graph.
        perception: the word of the perception that took part, e.g. ``taxinet``; '' if untold.
        fingerprint: sha256 of its weights, or ''.
        gains: steering gains that differed from the law's defaults.
        controller: what another controller than the steering law said of itself; '' for the law.
        controller_fingerprint: the sha256 that it told, or ''.
        timing: when its answers took effect.
    """

    request: RunRequest
    perception: str
    fingerprint: str
    gains: Mapping[str, float]
    controller: str = ''
    controller_fingerprint: str = ''
    timing: Timing = AT_ONCE


def read_run(path: Path) -> RecordedRun:
    """Read what run a bag holds.

    Raises:
        BagEmpty: the bag ends before it tells.
        BagForeign: what it tells is not of this package.
        UsageError: there is no bag, or a value of its scenario is out of range.
    """
    scenario: Any = None
    kinds: dict[str, Any] = {}
    for topic, _, message in decoded_messages(path, _HEAD.__contains__):
        if topic == '/scenario':
            if scenario is not None:
                raise several_runs(path, scenario.run_id, message.run_id)
            scenario = message
        elif topic == '/node_status':
            kinds.setdefault(message.node, message)
        else:
            break
    if scenario is None:
        raise BagEmpty(f'{path}: no message on /scenario, so its run is not known', path=path)
    try:
        eyes, law = kinds.get('perception'), kinds.get('steering_controller')
        world = kinds.get('simulator')
        words = law.implementation if law else ''
        ours = is_steering_law(words)
        return RecordedRun(
            request=_request(scenario),
            perception=eyes.implementation if eyes else '',
            fingerprint=eyes.fingerprint if eyes else '',
            gains=gains_of_words(words) if ours else {},
            controller='' if ours else words,
            controller_fingerprint=law.fingerprint if law else '',
            timing=parse_timing(world.implementation) if world else AT_ONCE,
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise BagForeign(f'{path}: /scenario or /node_status: {error}', path=path) from error
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def words_of_gains(gains: Mapping[str, float]) -> str:
    """Steering gains as a controller reports them; the inverse of :func:`gains_of_words`."""
    return ' '.join(f'{name}={value!r}' for name, value in gains.items())


def is_steering_law(words: str) -> bool:
    """Whether what a controller said of itself is what the steering law says: its tuned gains."""
    known = SteeringGains.__dataclass_fields__
    return all(word.partition('=')[0] in known for word in words.split())


def gains_of_words(words: str) -> dict[str, float]:
    """Steering gains out of a controller's report.

    Raises:
        ValueError: it is none.
        UsageError: a gain is out of range.
    """
    pairs = (word.split('=') for word in words.split())
    gains = {name: float(value) for name, value in pairs}
    if unknown := set(gains) - set(SteeringGains.__dataclass_fields__):
        raise ValueError(f'unknown steering gain {min(unknown)!r}')
    SteeringGains(**gains)
    return gains


def _request(message: Any) -> RunRequest:
    if not is_run_name(message.run_id):
        raise ValueError(f'run_id {message.run_id!r} is no name for a folder')
    return RunRequest(
        run_id=message.run_id, index=int(message.index), program=message.program,
        seed=int(message.seed), scenario=scenario_of(message), specs=tuple(message.specs),
        participants=tuple(message.participants),
        # Bags from before there was a choice lack these.
        stop_on=parse_stop_on(getattr(message, 'stop_on', '')),
        bounds=tuple(getattr(message, 'bounds', ())), rates=tuple(getattr(message, 'rates', ())),
    )
