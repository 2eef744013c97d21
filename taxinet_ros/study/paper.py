"""What the paper reports of its own networks, in its own simulator, to hold ours against.

Fremont, Chiu, Margineantu, Osipychev and Seshia, Formal Analysis and Redesign of a Neural
Network-Based Aircraft Taxiing System with VerifAI, CAV 2020. Nothing here is used to tune anything.
"""

from __future__ import annotations

from dataclasses import dataclass

from taxinet_ros.study.plan import GENERIC, HALTON, ITERATIVE, ORIGINAL, SPECIALISED


@dataclass(frozen=True, kw_only=True, slots=True)
class PaperNetwork:
    """A network's rates, as fractions.

    Attributes:
        satisfied: share of the runs that satisfy phi_eventually.
        off_runway: share that leaves the runway; None where the paper does not say.
        source: where the paper says so.
    """

    satisfied: float
    off_runway: float | None
    source: str


_RETRAINING, _APPENDIX = 'section 3.4', 'appendix A.1'

PAPER_NETWORKS = {
    ORIGINAL: PaperNetwork(satisfied=0.552, off_runway=0.091, source='section 3.2'),
    GENERIC: PaperNetwork(satisfied=0.82, off_runway=0.039, source=_RETRAINING),
    HALTON: PaperNetwork(satisfied=0.83, off_runway=0.006, source=_RETRAINING),
    SPECIALISED: PaperNetwork(satisfied=0.86, off_runway=0.005, source=_RETRAINING),
    ITERATIVE[0]: PaperNetwork(satisfied=0.85, off_runway=None, source=_APPENDIX),
    ITERATIVE[1]: PaperNetwork(satisfied=0.73, off_runway=None, source=_APPENDIX),
    ITERATIVE[2]: PaperNetwork(satisfied=0.82, off_runway=None, source=_APPENDIX),
}
"""By the study's names."""

PAPER_RUNS = 4_000
"""About so many runs were made with each network."""

PAPER_RULE = 'ce-verifai'
"""The sampler that learns as the paper's did."""

LEARNED_EDGES_M = (0.0, 200.0, 1200.0, 1400.0, 1600.0, 2000.0)
"""Ends of the stretches of runway that the paper tells apart."""

PAPER_LEARNED = (0.05, None, 0.16, 0.79, None)
"""What cross-entropy learned of the generic network's failures, by stretch (section 3.4)."""

PAPER_ELSEWHERE = 0.01
"""What it gave to the stretches without a figure of their own, together."""

CROSSING_M = (1200.0, 1600.0)
"""Starts that bracket the crossing near 1,450 m (Fig. 8)."""

START_M = (0.0, 400.0)
"""Starts at which the paper's model also has difficulty (Figs. 6 and 8)."""

EARLY_H, LATE_MORNING_H = (6.0, 8.0), (9.5, 12.0)
"""Where the original network consistently fails and where it works well (section 3.3, Fig. 4); the
limits are ours, the paper has none."""

EIGHT_H, TWO_H, AFTERNOON_H = (7.0, 9.0), (13.0, 15.0), (12.0, 18.0)
"""About 8 am and 2 pm (Fig. 5), and the afternoon of Fig. 7; the limits are ours."""

ALMOST_ALL = 0.95
"""Share of runs that "almost all" and "always" ask for; ours, the paper has none."""

SEVERAL_M = 2.0
"""What "several meters" ask for at least [m]; ours."""

EVEN = 0.10
"""Share by which parts of a day may differ that is "consistent across the entire day"; ours."""
