"""Errors of bags as exit codes, and a warning of results from different machines."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from taxinet_ros.bag.errors import BagCorrupt, BagError, BagTruncated, BagWriteError
from taxinet_ros.core.provenance import Provenance, differences
from taxinet_ros.errors import ExitCode


def exit_code_of(bag: Path, work: Callable[[], int]) -> int:
    """Run ``work`` on ``bag``; turn a bag error into one line and an exit code.

    Returns:
        The result of ``work``; after an error INCOMPLETE if part of the bag is recoverable, USAGE
        if nothing is, INFRA if the output could not be written.
    """
    try:
        return work()
    except BagWriteError as error:
        return _complain(str(error), ExitCode.INFRA)
    except (BagTruncated, BagCorrupt) as error:
        save = f'save the intact part: taxinet bag recover {shlex.quote(str(bag))} --out NEW'
        return _complain(f'{error}; {save}', ExitCode.INCOMPLETE)
    except BagError as error:
        return _complain(str(error), ExitCode.USAGE)


def _complain(text: str, code: int) -> int:
    print(f'taxinet: error: {" ".join(text.split())}', file=sys.stderr)
    return code


def warn_of_stacks(console: Console, *stacks: Provenance) -> None:
    """Warn in one line if compared results come from different machines, libraries or code.

    Args:
        console: console to print to.
        stacks: provenance of each result; empty if unknown.
    """
    if not all(stacks):
        line = 'processor and versions of some of these results are unknown'
    elif found := differences(*stacks):
        line = f'made on different machines or versions: {found}'
    else:
        return
    console.print(f'warning: {line}')
