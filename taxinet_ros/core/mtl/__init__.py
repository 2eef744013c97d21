"""Metric temporal logic with quantitative semantics: parse, evaluate, monitor.

A formula is judged on a run, which is a finite sequence of samples of named signals (units in
:data:`SIGNALS`). Its robustness rho is a signed distance from violation, in the unit of the
predicate that decides. The semantics, for a sample i at time t_i:

* *Stamps* are integer nanoseconds since the start of the run, strictly increasing, and need not be
  regular. Semantics is pointwise: time exists at samples only, and nothing is interpolated.
* A predicate ``e1 <= e2`` or ``e1 < e2`` has rho = e2 - e1; ``>=`` and ``>`` have rho = e1 - e2.
  ``not`` is minus, ``and`` the minimum, ``or`` the maximum, ``a implies b`` is ``(not a) or b``
  (Donzé and Maler, Robust satisfaction of temporal logic over real-valued signals, FORMATS 2010).
* *Windows are closed*: ``always[a:b] p`` is the minimum of p over samples j with
  t_i + a <= t_j <= t_i + b, ``eventually`` the maximum; ``historically`` and ``once`` look at
  t_i - b <= t_j <= t_i - a. Without a window they look at the rest of the run, the sample itself
  included. An *empty window* gives +inf (minimum) or -inf (maximum).
* ``p until[a:b] q`` is the maximum, over samples j in the window, of the minimum of q at j and p at
  all samples k with t_i <= t_k < t_j: p need not hold when q does. ``since`` is its mirror image.
* *Finite trace*: the run's robustness is rho at its first sample; the trace ends at its last.
* rho > 0 is SATISFIED and rho < 0 VIOLATED. rho = 0 is MARGINAL and counts as a failure, as it does
  in VerifAI (Dreossi et al., CAV 2019), whose monitor differs in three things: windows are half
  open, the last value is held beyond the end, and the last of repeated stamps is taken.

:func:`robustness` evaluates a finished run. :class:`Monitor` follows a run and gives the interval
of all values that rho can still take (robust satisfaction interval; Deshmukh et al., Formal Methods
in System Design 51, 2017). At the horizon both bounds equal :func:`robustness` bit for bit; a run
that ends early keeps an interval. Samples that are not finite or out of order are never evaluated:
offline they raise an error, online they make the run invalid from then on.
"""

from __future__ import annotations

from taxinet_ros.core.mtl.assumptions import (
    NO_ASSUMPTIONS,
    Assumptions,
    check_read,
    parse_assumptions,
    parse_bounds,
    parse_rates,
)
from taxinet_ros.core.mtl.ast import Formula, atoms, signal_names
from taxinet_ros.core.mtl.interval import RobustnessInterval, Verdict, exact_intervals, exact_rho
from taxinet_ros.core.mtl.offline import robustness
from taxinet_ros.core.mtl.online import Monitor, Reading
from taxinet_ros.core.mtl.specs import SHIPPED, SIGNALS, Spec, parse_formula, parse_spec

__all__ = [
    'NO_ASSUMPTIONS',
    'SHIPPED',
    'SIGNALS',
    'Assumptions',
    'Formula',
    'Monitor',
    'Reading',
    'RobustnessInterval',
    'Spec',
    'Verdict',
    'atoms',
    'check_read',
    'exact_intervals',
    'exact_rho',
    'parse_assumptions',
    'parse_bounds',
    'parse_formula',
    'parse_rates',
    'parse_spec',
    'robustness',
    'signal_names',
]
