"""Check a network in a few fixed scenes: a smoke test, not a rate.

The scenes are the first draws of a shipped program with a fixed seed, so the same for everybody:
results of two networks, or of two machines, can be laid side by side. Fifty scenes find a network
that is broken or badly trained. They prove little about a good one: if none of 50 is violated, the
share of violated scenes is below 5.8 % with 95 % confidence (1 - 0.05 ** (1 / 50)).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.system import System
from taxinet_ros.errors import ExitCode
from taxinet_ros.trials.past_runs.shared_scenes import Scene, scenes_of_program
from taxinet_ros.trials.past_runs.trials import Trial, TrialPool
from taxinet_ros.trials.requirements import DEFAULT_JUDGING
from taxinet_ros.trials.run_command import RunSettings

PROGRAM, SEED, SCENES = 's_falsif', 50, 50
MOST_SHOWN = 5


@dataclass(frozen=True, kw_only=True)
class NetworkCheck:
    """A network in the fixed scenes.

    Attributes:
        network: word or file.
        fingerprint: hash of its weights.
        scenes: the scenes, in order.
        trials: the results, in the same order.
    """

    network: str
    fingerprint: str
    scenes: tuple[Scene, ...]
    trials: tuple[Trial, ...]

    def count(self, passed: bool | None) -> int:
        """Number of scenes that are satisfied (True), violated (False) or unclear (None)."""
        return sum(trial.passed is passed for trial in self.trials)

    def worst(self) -> tuple[tuple[Scene, Trial], ...]:
        """Violated and unclear scenes, the most violated first."""
        pairs = zip(self.scenes, self.trials, strict=True)
        wrong = [pair for pair in pairs if pair[1].passed is not True]
        return tuple(sorted(wrong, key=lambda pair: _rho(pair[1])))

    def code(self, allowed: int) -> ExitCode:
        """1 with more violated scenes than allowed; 3 if unclear ones leave that open; else 0."""
        if self.count(False) > allowed:
            return ExitCode.VIOLATED
        unclear = self.count(False) + self.count(None) > allowed
        return ExitCode.INCOMPLETE if unclear else ExitCode.OK

    @property
    def command(self) -> str:
        """The command that makes the same runs with bags, to find the causes in."""
        settings = RunSettings(perception=self.network)
        return settings.command(
            PROGRAM, '--seed', str(SEED), '--runs', str(len(self.scenes)), '--engine', 'loop')

    def json(self, allowed: int) -> dict[str, Any]:
        """Everything as plain values."""
        return {
            'network': self.network, 'perception_sha256': self.fingerprint, 'program': PROGRAM,
            'seed': SEED, 'scenes': len(self.scenes), 'scenes_sha256': scenes_digest(self.scenes),
            'requirement': DEFAULT_JUDGING.headline, 'allowed': allowed,
            'satisfied': self.count(True), 'violated': self.count(False),
            'unclear': self.count(None), 'exit_code': int(self.code(allowed)),
            'worst': [
                {'run_id': scene.row.run_id, 'rho': _known_rho(trial), 'detail': trial.detail}
                for scene, trial in self.worst()
            ],
            'next': self.command,
        }


def _rho(trial: Trial) -> float:
    return float('inf') if trial.robustness is None else trial.robustness.lower


def _known_rho(trial: Trial) -> float | None:
    return None if trial.robustness is None else trial.robustness.lower


def fixed_scenes(number: int) -> tuple[Scene, ...]:
    """The first fixed scenes.

    Raises:
        UsageError: the program rejects most of its scenes.
    """
    return scenes_of_program(
        PROGRAM, runs=number, seed=SEED, judging=DEFAULT_JUDGING).scenes


def scenes_digest(scenes: Sequence[Scene]) -> str:
    """Digest of the scenes, to the bit, by which two machines see that theirs are the same."""
    text = '\n'.join(f'{scene.row.run_id} {scene.scenario!r}' for scene in scenes)
    return hashlib.sha256(text.encode()).hexdigest()


def check_networks(
    networks: Sequence[str], scenes: tuple[Scene, ...], *, workers: int,
    on_trial: Callable[[], None] = lambda: None,
    interrupted: Callable[[], bool] = lambda: False,
) -> Iterator[NetworkCheck]:
    """Drive each network through the scenes, in the closed loop without ROS.

    Ends early if interrupted.

    Raises:
        UsageError: there is no such network; before any is driven.
        InfraError: worker processes end one after the other.
    """
    prints = [check_perception(network) for network in networks]
    with TrialPool(workers) as pool:
        for network, fingerprint in zip(networks, prints, strict=True):
            system = System(perception=network)
            done: dict[str, Trial] = {}

            def take(trial: Trial, done: dict[str, Trial] = done) -> None:
                done[trial.run_id] = trial
                on_trial()

            pool.run((scene.task(system, DEFAULT_JUDGING) for scene in scenes), take, interrupted)
            if len(done) < len(scenes):
                return
            yield NetworkCheck(
                network=network, fingerprint=fingerprint, scenes=scenes,
                trials=tuple(done[scene.row.run_id] for scene in scenes),
            )
