"""How the tables of a study look to people: which columns, under which titles, in which units."""

from __future__ import annotations

import pandas as pd

from taxinet_ros.analysis.report_parts import Column, Table

_PERCENT = 100

Columns = tuple[tuple[str, str, int | None, bool], ...]
"""Name in the data frame, title, digits, and whether it is a share, to be shown in percent."""

NETWORK_COLUMNS: Columns = (
    ('network', 'network', None, False), ('runs', 'runs', None, False),
    ('satisfied', 'satisfied [%]', 1, True), ('satisfied_low', 'from', 1, True),
    ('satisfied_high', 'to', 1, True), ('paper_satisfied', 'the paper [%]', 1, True),
    ('off_runway', 'off the runway [%]', 1, True), ('off_runway_low', 'from', 1, True),
    ('off_runway_high', 'to', 1, True), ('paper_off_runway', 'the paper [%]', 1, True),
)
MORE_COLUMNS: Columns = (
    ('network', 'network', None, False), ('median_rho', 'median ρ [m]', 2, False),
    ('median_settle_s', 'median time to settle [s]', 1, False),
    ('median_settled_cte_m', 'median |CTE| after 10 s [m]', 3, False),
    ('median_cte_error_m', 'median error of CTE in a run [m]', 2, False),
    ('validation_cte_mae_m', 'error of CTE on pictures [m]', 3, False),
    ('validation_he_mae_deg', 'error of heading on pictures [°]', 3, False),
    ('without_verdict', 'runs without a verdict', None, False),
    ('perception', 'weights', None, False),
)
LEARNED_COLUMNS: Columns = (
    ('from_m', 'from [m]', 0, False), ('to_m', 'to [m]', 0, False),
    ('program', 'the program', 1, True),
    *(
        column for sampler in ('ce', 'ce-verifai', 'mab') for column in (
            (sampler, f'learned by {sampler}', 1, True), (f'{sampler}_least', 'least', 1, True),
            (f'{sampler}_greatest', 'greatest', 1, True),
        )
    ),
    ('of_failures', 'failures of random runs', 1, True), ('of_failures_low', 'from', 1, True),
    ('of_failures_high', 'to', 1, True), ('weighted', 'failures that ce found, weighted', 1, True),
    ('weighted_low', 'from', 1, True), ('weighted_high', 'to', 1, True),
    ('paper', 'learned in the paper', 1, True),
)
PAIR_COLUMNS: Columns = (
    ('first', 'first', None, False), ('second', 'second', None, False),
    ('scenes', 'scenes', None, False),
    ('satisfied_difference', 'satisfied', 1, True),
    ('satisfied_difference_low', 'from', 1, True), ('satisfied_difference_high', 'to', 1, True),
    ('satisfied_mcnemar_p', 'p', None, False),
    ('off_runway_difference', 'off the runway', 1, True),
    ('off_runway_difference_low', 'from', 1, True), ('off_runway_difference_high', 'to', 1, True),
    ('off_runway_mcnemar_p', 'p', None, False),
)


def binned(unit: str, digits: int) -> Columns:
    """Columns of a table by the hour, or by the metre."""
    return (
        ('network', 'network', None, False), (f'from_{unit}', f'from [{unit}]', digits, False),
        (f'to_{unit}', f'to [{unit}]', digits, False), ('runs', 'runs', None, False),
        ('satisfied', 'satisfied [%]', 1, True), ('satisfied_low', 'from', 1, True),
        ('satisfied_high', 'to', 1, True), ('off_runway', 'off the runway [%]', 1, True),
        ('median_rho', 'median ρ [m]', 2, False),
    )


def table_of(
    frame: pd.DataFrame, name: str, title: str, caption: str, columns: Columns
) -> Table:
    """A data frame as a table for people; columns that it lacks are left out."""
    present = [column for column in columns if column[0] in frame]
    return Table(
        name=name, title=title, caption=caption,
        columns=tuple(Column(name=key, title=words, decimals=digits)
                      for key, words, digits, _ in present),
        rows=tuple(
            tuple(_cell(line[key], share=share) for key, _, _, share in present)
            for line in frame.to_dict('records')
        ),
    )


def _cell(value: object, *, share: bool) -> str | int | float | None:
    if isinstance(value, str):
        return value
    if value is None or pd.isna(value):  # type: ignore[call-overload]  # a cell is no array
        return None
    assert isinstance(value, int | float)
    return _PERCENT * value if share else value
