"""Known limits of evidence: those of every result of this test bench, and those of these inputs.

Nothing is left out because it is inconvenient: what an input does not say is a limit, too. All
words on limits are in this file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from taxinet_ros.analysis.odd.coverage import OddCoverage
from taxinet_ros.campaign.record.facts import EXTENSIONS, WORLD, recorded_stacks
from taxinet_ros.core.pacing.timing import is_free, timing_words
from taxinet_ros.core.perception.weights import SHIPPED
from taxinet_ros.core.provenance import COMMIT, differences
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario_fields import BY_KEY
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.extras.evidence.figures import formula_rates
from taxinet_ros.extras.evidence.inputs import (
    TRUTH,
    CampaignInput,
    NetworkInput,
    ResultsInput,
)
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.registry import KMWH

WORDS = (
    'This is evidence toward a requirement. It says what was run and what came out; whether that '
    'is enough is for others to decide.'
)
"""What evidence is, for page and JSON."""


class Limit(NamedTuple):
    """One known limit.

    Attributes:
        id: identifier.
        about: what it is about: a system or campaign by its id; '' for everything.
        words: sentences.
        source: ``fixed``, or ``inputs`` if it follows from a fact of these inputs.
    """

    id: str
    about: str
    words: str
    source: str = 'inputs'


FIXED = (
    ('simulation', 'All runs are simulations: aircraft, tyres, light, weather and paint are '
     'models. How far they agree with an airport is not measured here.'),
    ('distribution', 'A rate is that of the program: of its hours, weather and starts, as often as '
     'it draws them. It is no rate of an airport, and says nothing about scenes that the program '
     'cannot draw.'),
    ('formula', 'Runs are judged by the formula. Whether it says what the words of the requirement '
     'mean is not checked by any tool.'),
    ('selection', 'Who names the campaigns chooses them. That no other campaign was run and left '
     'out cannot be seen from these.'),
    ('each-alone', 'Each 95 % interval holds for its own number. That all of them hold together is '
     'less certain.'),
    ('software', 'Simulator, monitor and statistics are software of one package, tested by its own '
     'tests; it is not qualified as a tool under any standard.'),
    ('checksums', 'The hashes show that nothing has changed since the runs. They do not show who '
     'made them: nothing is signed.'),
)
"""Limits of every result of this test bench, by name."""


@dataclass(frozen=True, kw_only=True)
class SystemFacts:
    """What limits of one system follow from.

    Attributes:
        name: its id.
        spec: formula that claim and ODD are about.
        campaigns: with their ids.
        network: its perception.
        coverage: of the ODD, if there is one.
        causes: localisations of its failed runs.
        monitors: judgements of run-time monitors with its network.
    """

    name: str
    spec: str
    campaigns: tuple[tuple[str, CampaignInput], ...]
    network: NetworkInput
    coverage: OddCoverage | None = None
    causes: tuple[ResultsInput, ...] = ()
    monitors: tuple[ResultsInput, ...] = ()

    @property
    def inputs(self) -> tuple[CampaignInput, ...]:
        """Its campaigns."""
        return tuple(one for _, one in self.campaigns)

    @property
    def facts(self) -> Any:
        """Facts of its first campaign; those that define the system are equal in all."""
        return self.campaigns[0][1].facts


def known_limits(
    systems: Sequence[SystemFacts], *, requirement: bool, claim: bool
) -> tuple[Limit, ...]:
    """All limits: first those of these inputs, then the fixed ones.

    Args:
        systems: the systems.
        requirement: whether the wording of a requirement was given.
        claim: whether a share was claimed.
    """
    found = _given('', (
        (not requirement, 'no-requirement', 'No wording of a requirement was given '
         '(--requirement); only the formula is known.'),
        (not claim, 'no-claim', 'No share was claimed (--claim), so the rates are given and not '
         'judged.'),
        (len(systems) > 1, 'several-systems', f'The campaigns are of {len(systems)} systems, which '
         'differ in program, formula, network, controller, world or timing. Their figures are kept '
         'apart.'),
    ))
    for system in systems:
        for part in (
            _of_rates, _of_world, _of_network, _of_domain, _of_causes, _of_monitors
        ):
            found += part(system)
        for name, one in system.campaigns:
            found += _of_campaign(name, one)
    return (*found, *(Limit(name, '', words, 'fixed') for name, words in FIXED))


def _given(about: str, rows: Sequence[tuple[object, str, str]]) -> list[Limit]:
    """Limits of the rows whose condition holds."""
    return [Limit(name, about, words) for holds, name, words in rows if holds]


def _of_rates(system: SystemFacts) -> list[Limit]:
    rates = formula_rates(system.inputs, system.spec)
    satisfied, undecided = rates.satisfied, rates.undecided.hits
    campaigns = len(system.campaigns)
    stacks = [stack for one in system.inputs for stack in recorded_stacks(one.facts).values()]
    differ = differences(*stacks)
    return _given(system.name, (
        (not satisfied.drawn, 'no-rate', f'There is no rate: {satisfied.why_not}.'),
        (0 < satisfied.drawn < satisfied.runs, 'chosen-scenes', 'A sampler chose '
         f'{satisfied.runs - satisfied.drawn:,} of the {satisfied.runs:,} judged runs by earlier '
         'results; these are in no rate.'),
        (undecided, 'undecided', f'{undecided:,} runs were stopped before {system.spec} was '
         'decided. They have no verdict on it, and which they are depends on their results.'),
        (campaigns > 1, 'pooled', f'The runs of {campaigns} campaigns of equal program, formula, '
         'network, controller and world are also added up. That interval is the one valid at any '
         'time, since whether to run another campaign may have depended on the results so far.'),
        (differ, 'several-stacks', 'The runs were made on several machines or versions: '
         f'{differ}.'),
    ))


def _of_world(system: SystemFacts) -> list[Limit]:
    facts = system.facts
    world, camera = world_and_camera(system.campaigns[0][1].system['world'])
    known, ours = WORLD in facts, camera == OURS and world == KMWH
    timing = str(facts.get('timing', ''))
    free = is_free(timing)
    return _given(system.name, (
        (not known, 'world-unknown', 'The world of the runs is that of the nodes that answered; '
         'the campaign does not record it.'),
        (known and ours, 'renderer', "The pictures are of this package's own renderer and the runs "
         'of its own world, not of X-Plane, in which the paper that the case study follows was '
         'run, and of no real camera.'),
        (known and not ours, 'renderer', f'World {world}, pictures by {camera}: another simulator, '
         'and no real camera.'),
        (free, 'free', 'Free runs cannot be repeated to the bit, so no run can be verified by '
         'running it again.'),
        (not timing, 'lockstep', 'Every answer of perception and controller took effect at once: '
         'delays of a real computer are not in these runs.'),
        (timing and not free, 'timing', f'Timing of the runs: {timing_words(timing)}; whether a '
         'real computer answers like that is not known.'),
        *(
            (True, f'extension-{kind}', f'{one["name"]} is code of {one["distribution"]} '
             f'{one["version"]} (sha256 {one["sha256"]}), not of this package.')
            for kind, one in facts.get(EXTENSIONS, {}).items()
        ),
    ))


def _of_network(system: SystemFacts) -> list[Limit]:
    network, card = system.network, system.network.card
    truth = network.word == TRUTH and not network.sha256
    sources = card.training_data if card is not None else ()
    kinds = {source.kind for source in sources}
    ledgers = {one.files[RECORD_NAME] for one in system.inputs}
    start = card.start_sha256 if card is not None else None
    return _given(system.name, (
        (truth, 'truth', 'There is no network in these runs: the controller is given the truth. '
         'They say nothing about perception.'),
        (not truth and card is None, 'data-unknown', f'The training data of {network.word} are '
         f'unknown: {network.why_unknown}.'),
        (card is not None and network.word in SHIPPED, 'network-origin', f'{network.word} is a '
         "network of this package, trained on its own pictures; it is not the network of the "
         "paper's authors, nor of any aircraft."),
        (kinds & {'program', 'runs'}, 'data-rendered', 'Training pictures were rendered by the '
         'same package as those of the runs, so differences from real pictures show in neither.'),
        (start is not None, 'training-start', f'Training began from other weights (sha256 {start}),'
         ' whose own data the model card names only as far as it repeats them.'),
        (any(one.sha256 == system.facts['program_sha256'] for one in sources), 'same-distribution',
         'The network was trained on scenes of the very program that the runs are drawn from '
         '(other draws).'),
        (any(one.kind == 'runs' and one.sha256 in ledgers for one in sources), 'trained-on-these',
         'The network was trained on failed runs of one of these campaigns: its rate there is too '
         'good.'),
    ))


def _of_domain(system: SystemFacts) -> list[Limit]:
    found = system.coverage
    if found is None:
        return [Limit('no-odd', system.name, 'No operational design domain was given (--odd), so '
                      'nothing is said about conditions that were not run.')]
    cells = sum(not one.rate.runs for one in found.cells)
    feasible, covered = next(
        ((one.feasible, one.covered) for one in found.strengths if one.t == 2), (0, 0)
    )
    fixed, unmentioned = (
        ', '.join(BY_KEY[key].label for key in keys) for keys in (found.fixed, found.unmentioned)
    )
    return _given(system.name, (
        (cells, 'odd-cells', f'{cells:,} of {len(found.cells):,} cells of the ODD '
         f'{found.odd.name} have no judged run.'),
        (covered < feasible, 'odd-pairs', f'{feasible - covered:,} of {feasible:,} feasible pairs '
         'of cells have no judged run.'),
        (found.judged > found.inside, 'odd-outside', f'{found.judged - found.inside:,} of '
         f'{found.judged:,} judged runs are outside of the ODD.'),
        (fixed, 'odd-fixed', f'{fixed}: in the ODD, but with one value in all runs.'),
        (unmentioned, 'odd-unmentioned', f'{unmentioned}: varied in the runs, but not in the ODD.'),
        *(
            (True, f'odd-caution-{number}', f'{words.rstrip(".")}.')
            for number, words in enumerate(found.cautions, 1)
        ),
    ))


def _of_causes(system: SystemFacts) -> list[Limit]:
    failed = sum(len(one.recorded.counterexamples) for one in system.inputs)
    examined = sum(one.figures['looked_into'] for one in system.causes)
    return _given(system.name, (
        (failed and not examined, 'no-localisation', f'None of the {failed:,} failed runs was '
         'driven again with perfect estimates, so whether network or controller caused them is not '
         'known (--localize).'),
        (0 < examined < failed, 'localised-in-part', f'{examined:,} of {failed:,} failed runs were '
         'driven again with perfect estimates; of the others the cause is not known.'),
    ))


def _of_monitors(system: SystemFacts) -> list[Limit]:
    own = Path(system.facts['program']).stem
    named = [(one, Path(one.figures['program']).stem) for one in system.monitors]
    return _given(system.name, (
        (system.network.sha256 and not system.monitors, 'no-monitor', 'No run-time monitor was '
         'judged with this network (--monitor-table).'),
        *(
            (True, f'monitor-program-{number}', 'The judgement of monitor '
             f'{one.figures["monitor"]} names its program by the word {program} only, not by a '
             f'hash{"" if program == own else f", which is not that of these campaigns ({own})"}. '
             f'Its {one.figures["runs"]:,} scenes were drawn with seed {one.figures["seed"]} and '
             f'driven with controller {one.figures["controller"]}.')
            for number, (one, program) in enumerate(named, 1)
        ),
    ))


def _of_campaign(name: str, one: CampaignInput) -> list[Limit]:
    facts, rows, stacks = one.facts, one.rows, recorded_stacks(one.facts)
    count = Counter(row.outcome for row in rows)
    broken, stopped = count[Outcome.INFRA_ERROR], count[Outcome.INTERRUPTED]
    blind = sum(row.passed_blind for row in rows)
    judged = one.recorded.judged
    lacking = sum(row.run_id not in one.bags for row in judged)
    commits = [stack.get(COMMIT, '') for stack in stacks.values()]
    return _given(name, (
        *(
            (True, f'warning-{number}', f'{str(words).rstrip(".")}.')
            for number, words in enumerate(facts.get('warnings', ()), 1)
        ),
        (broken, 'infra', f'{broken:,} of {len(rows):,} runs broke with an infrastructure error. '
         'They have no verdict and are in no rate of failure; that breaking does not depend on the '
         'scene is not shown.'),
        (stopped, 'interrupted', f'{stopped:,} runs were interrupted.'),
        (count[Outcome.REJECTED], 'rejected', f'{count[Outcome.REJECTED]:,} scenes were rejected '
         "by the program's own requirements and not run."),
        (blind, 'blind', f'{blind:,} runs passed with too many frames without a usable estimate.'),
        (lacking, 'no-bags', f'{lacking:,} of {len(judged):,} judged runs have no bag: their '
         'scenes are known to nine decimals, which is not enough to repeat them to the bit.'),
        (facts.get('engine') == 'loop' and not facts.get('audit_percent'), 'not-audited', 'The '
         'runs were made in one process without ROS, and none was repeated on the graph of nodes '
         '(--audit 0).'),
        (not stacks, 'stack-unknown', 'Machine and versions of the runs are not recorded.'),
        (any(commit.endswith('+changes') for commit in commits), 'edited-code', 'The code of the '
         'package had been edited beyond the recorded commit when runs were made.'),
        (not all(commits), 'commit-unknown', 'The commit of the package that made the runs is not '
         'known, only its version.'),
    ))
