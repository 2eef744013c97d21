"""What ``taxinet bag`` says of a bag that cannot be read, or written."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagTruncated, BagWriteError

WHOLE, UNREADABLE, LOSSY, NO_ROOM = 0, 2, 3, 4
"""Exit codes. 1 is kept for verdicts and for recordings that differ."""


def exit_code_of(bag: Path, work: Callable[[], int]) -> int:
    """Do ``work`` on ``bag``; a typed error becomes one line and an exit code.

    Returns:
        What ``work`` returned; or, after an error, :data:`LOSSY` where some of the bag could be
        saved, :data:`UNREADABLE` where none could, :data:`NO_ROOM` where something could not be
        written.
    """
    try:
        return work()
    except BagWriteError as error:
        return _complain(str(error), NO_ROOM)
    except (BagTruncated, BagCorrupt) as error:
        save = f'save what is sound: taxinet bag recover {shlex.quote(str(bag))} --out NEW'
        return _complain(f'{error}; {save}', LOSSY)
    except BagError as error:
        return _complain(str(error), UNREADABLE)


def _complain(text: str, code: int) -> int:
    print(f'taxinet: error: {" ".join(text.split())}', file=sys.stderr)
    return code
