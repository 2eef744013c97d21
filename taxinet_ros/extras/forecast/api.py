"""Forecasts of final robustness: bounds on a run in progress."""

from __future__ import annotations

import os
from pathlib import Path

from taxinet_ros.arguments import PATH, takes
from taxinet_ros.extras.forecast.forecast import Forecast, read_forecast


@takes(path=PATH)
def load_forecast(path: str | os.PathLike[str]) -> Forecast:
    """Load a forecast that ``taxinet forecast calibrate`` has written.

    ``.watch()`` gives an object whose ``.update(…)`` takes one control step after the other and
    answers with the bound; ``.bounds_of(recording)`` takes a recorded run.

    Args:
        path: the file.

    Raises:
        UsageError: there is none, or it is damaged or of another version.
    """
    return read_forecast(Path(path))
