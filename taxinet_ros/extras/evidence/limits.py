"""Known limits of evidence: those of every result of this test bench, and those of these inputs.

Nothing is left out because it is inconvenient: what an input does not say is a limit, too. All
words on limits are in this file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from taxinet_ros.analysis.odd.coverage import OddCoverage
from taxinet_ros.campaign.record.facts import EXTENSIONS, LEDGER_NAME, WORLD, recorded_stacks
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
    LocalisationInput,
    MonitorInput,
    NetworkInput,
)
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
        causes, monitors: localisations and judged monitors.
    """

    name: str
    spec: str
    campaigns: tuple[tuple[str, CampaignInput], ...]
    network: NetworkInput
    coverage: OddCoverage | None = None
    causes: tuple[LocalisationInput, ...] = ()
    monitors: tuple[MonitorInput, ...] = ()

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
    found = []
    if not requirement:
        found.append(Limit('no-requirement', '', 'No wording of a requirement was given '
                           '(--requirement); only the formula is known.'))
    if not claim:
        found.append(Limit('no-claim', '', 'No share was claimed (--claim), so the rates are given '
                           'and not judged.'))
    if len(systems) > 1:
        found.append(Limit(
            'several-systems', '', f'The campaigns are of {len(systems)} systems, which differ in '
            'program, formula, network, controller, world or timing. Their figures are kept apart.',
        ))
    for system in systems:
        found += _of_system(system)
        for name, one in system.campaigns:
            found += _of_campaign(name, one)
    return (*found, *(Limit(name, '', words, 'fixed') for name, words in FIXED))


def _of_system(system: SystemFacts) -> Iterator[Limit]:
    facts, name = system.facts, system.name
    yield from _of_world(system)
    yield from _of_network(system)
    rates = formula_rates(system.inputs, system.spec)
    if not rates.satisfied.drawn:
        yield Limit('no-rate', name, f'There is no rate: {rates.satisfied.why_not}.')
    elif rates.satisfied.drawn < rates.satisfied.runs:
        more = rates.satisfied.runs - rates.satisfied.drawn
        yield Limit('chosen-scenes', name, f'A sampler chose {more:,} of the '
                    f'{rates.satisfied.runs:,} judged runs by earlier results; these are in no '
                    'rate.')
    if rates.undecided.hits:
        yield Limit('undecided', name, f'{rates.undecided.hits:,} runs were '
                    f'stopped before {system.spec} was decided. They have no verdict on it, and '
                    'which they are depends on their results.')
    if len(system.campaigns) > 1:
        yield from _of_adding(system)
    if system.coverage is None:
        yield Limit('no-odd', name, 'No operational design domain was given '
                    '(--odd), so nothing is said about conditions that were not run.')
    else:
        yield from _of_domain(name, system.coverage)
    failed = sum(len(one.recorded.counterexamples) for one in system.inputs)
    examined = sum(one.figures['looked_into'] for one in system.causes)
    if failed and not examined:
        yield Limit('no-localisation', name, f'None of the {failed:,} failed runs '
                    'was driven again with perfect estimates, so whether network or controller '
                    'caused them is not known (--localize).')
    elif examined < failed:
        yield Limit('localised-in-part', name, f'{examined:,} of {failed:,} failed '
                    'runs were driven again with perfect estimates; of the others the cause is not '
                    'known.')
    if not system.monitors and system.network.sha256:
        yield Limit('no-monitor', name, 'No run-time monitor was judged with this '
                    'network (--monitor-table).')
    for one in system.monitors:
        options = one.options
        program = str(options['program'])
        own = str(facts['program']).removesuffix('.scenic')
        also = '' if program == own else f', which is not that of these campaigns ({own})'
        yield Limit('monitor-program', name, 'The table of the run-time monitor '
                    f'names its program by the word {program} only, not by a hash{also}. Its '
                    f'{one.judged["runs"]:,} scenes were drawn with seed {options["seed"]}.')


def _of_adding(system: SystemFacts) -> Iterator[Limit]:
    yield Limit('pooled', system.name, f'The runs of {len(system.campaigns)} campaigns '
                'of equal program, formula, network, controller and world are also added up. '
                'That interval is the one valid at any time, since whether to run another '
                'campaign may have depended on the results so far.')
    stacks = [stack for one in system.inputs for stack in recorded_stacks(one.facts).values()]
    if differ := differences(*stacks):
        yield Limit('pooled-stacks', system.name, 'The campaigns added up were made on several '
                    f'machines or versions: {differ}.')


def _of_world(system: SystemFacts) -> Iterator[Limit]:
    facts, name = system.facts, system.name
    world, camera = world_and_camera(system.campaigns[0][1].system['world'])
    if WORLD not in facts:
        yield Limit('world-unknown', name, 'The world of the runs is that of the '
                    'nodes that answered; the campaign does not record it.')
    elif camera == OURS and world == KMWH:
        yield Limit('renderer', name, "The pictures are of this package's own "
                    'renderer and the runs of its own world, not of X-Plane, in which the paper '
                    'that the case study follows was run, and of no real camera.')
    else:
        yield Limit('renderer', name, f'World {world}, pictures by {camera}: '
                    'another simulator, and no real camera.')
    timing = str(facts.get('timing', ''))
    if is_free(timing):
        yield Limit('free', name, 'Free runs cannot be repeated to the bit, so no '
                    'run can be verified by running it again.')
    elif not timing:
        yield Limit('lockstep', name, 'Every answer of perception and controller '
                    'took effect at once: delays of a real computer are not in these runs.')
    else:
        yield Limit('timing', name, f'Timing of the runs: {timing_words(timing)}; '
                    'whether a real computer answers like that is not known.')
    for kind, one in facts.get(EXTENSIONS, {}).items():
        yield Limit(f'extension-{kind}', name, f'{one["name"]} is code of '
                    f'{one["distribution"]} {one["version"]} (sha256 {one["sha256"]}), not of this '
                    'package.')


def _of_network(system: SystemFacts) -> Iterator[Limit]:
    network, name = system.network, system.name
    if network.word == TRUTH and not network.sha256:
        yield Limit('truth', name, 'There is no network in these runs: the '
                    'controller is given the truth. They say nothing about perception.')
        return
    if network.card is None:
        yield Limit('data-unknown', name, f'The training data of {network.word} are '
                    f'unknown: {network.why_unknown}.')
        return
    card = network.card
    if network.word in SHIPPED:
        yield Limit('network-origin', name, f'{network.word} is a network of this '
                    "package, trained on its own pictures; it is not the network of the paper's "
                    'authors, nor of any aircraft.')
    kinds = {source.kind for source in card.training_data}
    if 'program' in kinds or 'runs' in kinds:
        yield Limit('data-rendered', name, 'Training pictures were rendered by the '
                    'same package as those of the runs, so differences from real pictures show in '
                    'neither.')
    if card.start_sha256 is not None:
        yield Limit('training-start', name, 'Training began from other weights '
                    f'(sha256 {card.start_sha256}), whose own data the model card names only as '
                    'far as it repeats them.')
    own = system.facts['program_sha256']
    if any(source.sha256 == own for source in card.training_data):
        yield Limit('same-distribution', name, 'The network was trained on scenes '
                    'of the very program that the runs are drawn from (other draws).')
    ledgers = {one.files[LEDGER_NAME] for one in system.inputs}
    if any(source.kind == 'runs' and source.sha256 in ledgers for source in card.training_data):
        yield Limit('trained-on-these', name, 'The network was trained on failed '
                    'runs of one of these campaigns: its rate there is too good.')


def _of_domain(name: str, found: OddCoverage) -> Iterator[Limit]:
    open_cells = sum(1 for one in found.cells if not one.rate.runs)
    pairs = next((one for one in found.strengths if one.t == 2), None)
    if open_cells:
        yield Limit('odd-cells', name, f'{open_cells:,} of {len(found.cells):,} '
                    f'cells of the ODD {found.odd.name} have no judged run.')
    if pairs is not None and pairs.covered < pairs.feasible:
        yield Limit('odd-pairs', name, f'{pairs.feasible - pairs.covered:,} of '
                    f'{pairs.feasible:,} feasible pairs of cells have no judged run.')
    if found.judged > found.inside:
        yield Limit('odd-outside', name, f'{found.judged - found.inside:,} of '
                    f'{found.judged:,} judged runs are outside of the ODD.')
    for keys, limit, words in (
        (found.fixed, 'odd-fixed', 'in the ODD, but with one value in all runs'),
        (found.unmentioned, 'odd-unmentioned', 'varied in the runs, but not in the ODD'),
    ):
        if keys:
            labels = ', '.join(BY_KEY[key].label for key in keys)
            yield Limit(limit, name, f'{labels}: {words}.')
    for number, words in enumerate(found.cautions, 1):
        yield Limit(f'odd-caution-{number}', name, f'{words.rstrip(".")}.')


def _of_campaign(name: str, one: CampaignInput) -> Iterator[Limit]:
    facts, rows = one.facts, one.rows
    for number, words in enumerate(facts.get('warnings', ()), 1):
        yield Limit(f'warning-{number}', name, f'{str(words).rstrip(".")}.')
    broken = sum(row.outcome is Outcome.INFRA_ERROR for row in rows)
    if broken:
        yield Limit('infra', name, f'{broken:,} of {len(rows):,} runs broke with an '
                    'infrastructure error. They have no verdict and are in no rate of failure; '
                    'that breaking does not depend on the scene is not shown.')
    stopped = sum(row.outcome is Outcome.INTERRUPTED for row in rows)
    if stopped:
        yield Limit('interrupted', name, f'{stopped:,} runs were interrupted.')
    rejected = sum(row.outcome is Outcome.REJECTED for row in rows)
    if rejected:
        yield Limit('rejected', name, f'{rejected:,} scenes were rejected by the '
                    "program's own requirements and not run.")
    blind = sum(row.passed_blind for row in rows)
    if blind:
        yield Limit('blind', name, f'{blind:,} runs passed with too many frames '
                    'without a usable estimate.')
    for line in one.recorded.content.lost:
        yield Limit('mended', name, f'The ledger was mended: {line.rstrip(".")}.')
    yield from _of_bags(name, one)
    yield from _of_making(name, one)


def _of_making(name: str, one: CampaignInput) -> Iterator[Limit]:
    """What is known of how, where and with which code the runs were made."""
    facts = one.facts
    if facts.get('engine') == 'loop' and not facts.get('audit_percent'):
        yield Limit('not-audited', name, 'The runs were made in one process without '
                    'ROS, and none was repeated on the graph of nodes (--audit 0).')
    stacks = recorded_stacks(facts)
    if not stacks:
        yield Limit('stack-unknown', name, 'Machine and versions of the runs are '
                    'not recorded.')
    if len(stacks) > 1:
        yield Limit('several-stacks', name, 'The runs were made on several machines '
                    f'or versions: {differences(*stacks.values())}.')
    if any(stack.get(COMMIT, '').endswith('+changes') for stack in stacks.values()):
        yield Limit('edited-code', name, 'The code of the package had been edited '
                    'beyond the recorded commit when runs were made.')
    if stacks and not all(COMMIT in stack for stack in stacks.values()):
        yield Limit('commit-unknown', name, 'The commit of the package that made '
                    'the runs is not known, only its version.')


def _of_bags(name: str, one: CampaignInput) -> Iterator[Limit]:
    ran = [row for row in one.rows if row.outcome.judged]
    lacking = sum(row.run_id not in one.bags for row in ran)
    if lacking:
        yield Limit('no-bags', name, f'{lacking:,} of {len(ran):,} judged runs have '
                    'no bag: their scenes are known to nine decimals, which is not enough to '
                    'repeat them to the bit.')

