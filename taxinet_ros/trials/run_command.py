"""Commands printed for the user: ``taxinet run`` with every setting that differs from its default.

A document that is not shipped may be as long as an aircraft's XML files, so a command names a JSON
file of it; whoever prints a command writes its files.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from taxinet_ros.core.documents import NamedDocument
from taxinet_ros.core.motion.controller import STEERING, controller_options
from taxinet_ros.core.mtl import signal_names
from taxinet_ros.core.pacing.timing import parse_timing
from taxinet_ros.core.scenario_fields import CATALOGUES
from taxinet_ros.core.system import System
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.world import world_options
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.facts import recorded_world
from taxinet_ros.trials.requirements import DEFAULT_JUDGING


@dataclass(frozen=True, kw_only=True)
class RunSettings(System):
    """Settings of runs, as options of ``taxinet run``.

    Attributes:
        values: scenario values that replace drawn ones, in human keys and units.
        judging: requirements, stop rule and assumptions.
    """

    values: Mapping[str, Any] = field(default_factory=dict)
    judging: Judging = DEFAULT_JUDGING

    @classmethod
    def of_options(cls, options: CampaignOptions) -> Self:
        """Settings of all runs of a campaign."""
        return cls(
            perception=options.perception, controller=options.controller, world=options.world,
            gains=options.gains, values={**options.overrides, **options.laid_over},
            judging=options.judging, timing=options.timing,
        )

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> Self:
        """Settings of all runs of a recorded campaign.

        Raises:
            UsageError: a recorded value is invalid.
        """
        return cls(
            perception=str(facts.get('perception', '')),
            controller=str(facts.get('controller', STEERING)), world=recorded_world(facts)[0],
            gains=facts.get('gains', {}),
            values={**facts.get('overrides', {}), **facts.get('laid_over', {})},
            judging=Judging.from_facts(facts), timing=parse_timing(str(facts.get('timing', ''))),
        )

    @property
    def graph_only(self) -> bool:
        """Whether only the graph of nodes can make such runs, or they cannot be had again."""
        return bool(self.not_again) or any(
            map(is_node_elsewhere, (self.perception, self.controller)))

    def headed_by(self, spec: str, *, alone: bool = False) -> Self:
        """The settings with one of the requirements first, and the assumptions that they read.

        Args:
            spec: name or text of the requirement.
            alone: leave the others out.
        """
        judging = self.judging.headed_by(spec)
        if alone:
            judging = replace(judging, specs=judging.specs[:1])
        read = {name for one in judging.parsed_specs for name in signal_names(one.formula)}
        return replace(self, judging=replace(
            judging, bounds=_about(read, judging.bounds), rates=_about(read, judging.rates),
        ))

    def command(
        self, program: str, *words: str, folder: Path = Path(), verb: str = 'run'
    ) -> str:
        """Shell command that runs scenes of a program with these settings.

        Args:
            program: word or path of the Scenic program.
            words: further options, which follow the program.
            folder: folder of the files of :meth:`documents`.
            verb: the command, ``run`` or ``falsify``.

        Raises:
            UsageError: a document is known by its digest only.
        """
        return shlex.join([
            'taxinet', verb, program, *words, '--perception', self.perception,
            *self.options(folder),
        ])

    def compare_command(self, other: str, program: str, *words: str) -> str:
        """Shell command that compares the perception with another, on scenes of a program.

        Args:
            other: word or file of the other.
            program: word or path of the Scenic program.
            words: further options, which follow the program.
        """
        # Only when a run ends depends on it, not its verdict.
        judged = replace(self, judging=replace(self.judging, stop_on=StopOn.NEVER))
        return shlex.join([
            'taxinet', 'compare', self.perception, other, program, *words, *judged.options(),
        ])

    def options(self, folder: Path = Path()) -> list[str]:
        """All settings but the perception, as options.

        Args:
            folder: folder of the files of :meth:`documents`.

        Raises:
            UsageError: a document is known by its digest only.
        """
        settings = [f'{key}={text}' for key, text in self.texts(folder).items()]
        return [
            *controller_options(self.controller), *world_options(self.world),
            *_judging_options(self.judging),
            *(word for setting in settings for word in ('--set', setting)),
            *self.timing.options,
        ]

    def texts(self, folder: Path = Path()) -> dict[str, str]:
        """Values and gains as text by key, as for ``--set``.

        Args:
            folder: folder of the files of :meth:`documents`.

        Raises:
            UsageError: a document is known by its digest only.
        """
        gains = {f'steering.{name}': value for name, value in self.gains.items()}
        return {
            key: _setting(key, value, folder) for key, value in {**self.values, **gains}.items()
        }

    def documents(self) -> dict[str, str]:
        """Text by file name of every document that is not shipped.

        Raises:
            UsageError: one is known by its digest only.
        """
        found = [(key, _document(key, value)) for key, value in self.values.items()]
        return {_file_name(key, one): one.document for key, one in found if one and not one.shipped}


def _about(signals: Collection[str], texts: Iterable[str]) -> tuple[str, ...]:
    return tuple(text for text in texts if text.partition('=')[0].strip() in signals)


def _judging_options(judging: Judging) -> list[str]:
    words = []
    if judging.specs and judging.parsed_specs != DEFAULT_JUDGING.parsed_specs:
        words += [word for text in judging.specs for word in ('--spec', text)]
    if judging.stop_on is not StopOn.NEVER:
        words += ['--stop-on', judging.stop_on.value]
    words += [word for text in judging.bounds for word in ('--bound', text)]
    return words + [word for text in judging.rates for word in ('--rate', text)]


def _setting(key: str, value: Any, folder: Path) -> str:
    if isinstance(value, bool):
        return 'on' if value else 'off'
    if (document := _document(key, value)) is not None:
        return document.name if document.shipped else str(folder / _file_name(key, document))
    return repr(value) if isinstance(value, float) else str(value)


def _document(key: str, value: Any) -> NamedDocument | None:
    found: NamedDocument | None = CATALOGUES[key].typed(str(value)) if key in CATALOGUES else None
    return found


def _file_name(key: str, document: NamedDocument) -> str:
    return f'{key}-{document.reference}.json'
