"""Evidence toward a requirement, from Python."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from taxinet_ros.arguments import (
    FINITE,
    FROM_0,
    NONE,
    PATH,
    TEXT,
    WORD,
    Kind,
    takes,
)
from taxinet_ros.extras.evidence import verify
from taxinet_ros.extras.evidence.evidence import make_evidence
from taxinet_ros.extras.evidence.inputs import read_requirement

_PATHS = PATH | Kind('a list of paths', lambda value: isinstance(value, list | tuple) and all(
    PATH.has(one) for one in value))
_Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]


@takes(
    campaigns=_PATHS, out=PATH, requirement=NONE | TEXT, claim=NONE | FINITE, spec=NONE | WORD,
    odd=NONE | PATH, localize=_PATHS, monitor_table=_PATHS, perception=_PATHS,
)
def evidence(
    campaigns: _Paths, out: str | os.PathLike[str], *, requirement: str | None = None,
    claim: float | None = None, spec: str | None = None, odd: str | os.PathLike[str] | None = None,
    localize: _Paths = (), monitor_table: _Paths = (), perception: _Paths = (),
) -> dict[str, Any]:
    """Write evidence toward a requirement, as ``taxinet evidence``.

    Args:
        campaigns: folder of a finished campaign, or several.
        out: new folder for page, JSON, argument and manifest.
        requirement: ``'REQ-7: The aircraft shall …'``, or a file with that.
        claim: least share of satisfied runs that is claimed, 0..1 exclusively.
        spec: formula of claim and ODD; None for the headline.
        odd: name or file of an operational design domain.
        localize: folders of ``taxinet localize``.
        monitor_table: folders of ``taxinet assure judge``.
        perception: files of networks that have moved.

    Returns:
        The values of ``evidence.json``: ``systems`` with ``figures`` and ``claim``, ``items`` with
        their hashes, ``limits``, ``argument``.

    Raises:
        UsageError: an input is refused; the line names it.
    """
    found = make_evidence(
        _paths(campaigns), Path(out), claim=claim, spec=spec,
        requirement=None if requirement is None else read_requirement(requirement),
        odd=None if odd is None else os.fspath(odd), localisations=_paths(localize),
        monitors=_paths(monitor_table), networks=tuple(map(str, _paths(perception))),
    )
    return found.content


@takes(folder=PATH, campaigns=_PATHS, sample=FROM_0, seed=FROM_0, perception=_PATHS)
def verify_evidence(
    folder: str | os.PathLike[str], *, campaigns: _Paths = (), sample: int = 5, seed: int = 0,
    perception: _Paths = (),
) -> verify.Verification:
    """Verify evidence, as ``taxinet evidence verify``.

    Args:
        folder: folder of the evidence.
        campaigns: folders of campaigns and other inputs that have moved.
        sample: number of runs to drive again.
        seed: chooses them.
        perception: files of networks that have moved.

    Returns:
        ``.holds``; ``.damaged``, ``.different`` and ``.unchecked``, with one line for each finding;
        ``.checked``, the number of things that hold by kind.

    Raises:
        UsageError: the folder is none of evidence.
    """
    return verify.verify(
        Path(folder), moved=_paths(campaigns), sample=sample, seed=seed,
        networks=tuple(map(str, _paths(perception))),
    )


def _paths(given: _Paths) -> tuple[Path, ...]:
    return (Path(given),) if isinstance(given, str | os.PathLike) else tuple(map(Path, given))
