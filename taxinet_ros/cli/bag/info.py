"""``taxinet bag info``: show the contents of a bag as text or JSON."""

from __future__ import annotations

from pathlib import Path

from taxinet_ros.cli.options import BagArgument, JsonOption
from taxinet_ros.cli.show import print_json
from taxinet_ros.errors import ExitCode


def info(bag: BagArgument, as_json: JsonOption = False) -> int:
    """Show the contents of a bag: run, scene, outcome, robustness, topics."""
    from taxinet_ros.cli.bag.input import exit_code_of

    return exit_code_of(bag, lambda: _show(bag, as_json))


def _show(bag: Path, as_json: bool) -> int:
    from taxinet_ros.analysis.one_run.info import info_json, info_text
    from taxinet_ros.bag.run.recording import open_recording

    recording = open_recording(bag)
    if recording.plain or not recording.runs:
        runs = {'': recording.facts}
    else:
        runs = {run.words(): one.facts for run, one in zip(recording.runs, recording, strict=True)}
    if as_json:
        print_json(info_json(recording.info, recording, list(runs.values())))
    else:
        print(info_text(recording, runs))
    return ExitCode.OK if recording.info.complete else ExitCode.INCOMPLETE
