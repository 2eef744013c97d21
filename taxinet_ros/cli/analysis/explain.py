"""``taxinet explain``: explain why the network failed in one recorded run."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from taxinet_ros.analysis.explain.explain import Explanation, explain
from taxinet_ros.analysis.explain.report import explain_json, explain_report
from taxinet_ros.bag.run.facts import RecordedRun
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.cli.bag.input import perception_of, readable_bags
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.renderer import ChosenRenderer, find_renderer
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.files.atomic import make_folder, write_atomically
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, new_folder

JSON_NAME, PAGE_NAME = 'explain.json', 'explain.html'


@dataclass(frozen=True, kw_only=True)
class ExplainOptions:
    """Options of ``taxinet explain``.

    Attributes:
        bag: a run folder or an ``.mcap`` file.
        perception: word or file; None: the run's own.
        frames: maximum number of moments to examine.
        camera: who takes pictures of the modified scenes, the run's camera; None: ours does, and
            those of another camera are not modified.
        out: new folder for page and images; None: one below ``bags/``.
        as_json: print the JSON instead of the summary.
    """

    recording: Recording
    perception: str | None
    frames: int
    camera: str | None
    out: Path | None
    as_json: bool


def run_explain(options: ExplainOptions) -> int:
    """Examine the run, write page, images and JSON, and print the summary.

    Returns:
        Exit code: 0.

    Raises:
        UsageError: bad input.
        InfraError: the camera failed.
    """
    console = Console(highlight=False, stderr=options.as_json)
    with readable_bags():
        run = options.recording.run
        word = _network(run, options.perception)
        renderer = _renderer(run, options.camera)
        out = options.out or new_folder(DEFAULT_ROOT / f'explain-{run.request.run_id}')
        check_new(out)
        with stage_bars(console) as show:
            found = explain(
                options.recording, make_perception(word), frames=options.frames,
                on_progress=show, renderer=renderer,
            )
    _make(out)
    written = _write(found, out)
    if options.as_json:
        print(json.dumps(explain_json(found), indent=2, allow_nan=False))
        return ExitCode.OK
    console.print(f'{run.request.run_id}, network {word}', soft_wrap=True, markup=False)
    for sentence in explain_report(found).summary:
        console.print(sentence, soft_wrap=True, markup=False)
    console.print(f'page: {written}', soft_wrap=True, markup=False)
    return ExitCode.OK


def _network(run: RecordedRun, asked: str | None) -> str:
    """Word or file of the network to examine; by default the run's own, if available."""
    name = run.request.run_id
    if asked == 'truth':
        raise UsageError('--perception truth: uses no camera image; name a network')
    if asked is None and run.perception == 'truth':
        raise UsageError(
            f'{name}: was run with ground truth, not a network; name one with --perception')
    word, fingerprint = perception_of(run, asked)
    if asked is None and fingerprint != run.fingerprint:
        raise UsageError(
            f"{name}: was driven by a {word} of sha256 {run.fingerprint[:12]}…, and today's has "
            f'{fingerprint[:12]}…; name the file, or another network, with --perception'
        )
    return word


def _renderer(run: RecordedRun, asked: str | None) -> ChosenRenderer | None:
    """The camera that is asked for pictures of modified scenes; None for ours."""
    _, camera = world_and_camera(run.world or KMWH)
    if asked is None:
        return None
    found = find_renderer(asked)
    theirs = '' if found is None else found.fingerprint
    # A file may have moved since; its contents tell.
    if asked == camera or (theirs and theirs == run.world_fingerprint):
        return found
    raise UsageError(
        f'--camera {asked}: the pictures of {run.request.run_id} are of the camera {camera}, and '
        'pictures of another one would differ in everything; leave it out, or take '
        f'--camera {camera}'
    )


def _make(out: Path) -> None:
    try:
        make_folder(out)
    except OSError as error:
        raise UsageError(f'--out {out}: cannot be written: {error.strerror}') from error


def _write(found: Explanation, out: Path) -> Path:
    """Write images, JSON and page; return the page's path."""
    from taxinet_ros.analysis.report.page import write_report_page
    from taxinet_ros.analysis.report.pictures import write_pictures

    report = explain_report(found)
    write_pictures(report, out)
    write_atomically(
        out / JSON_NAME, json.dumps(explain_json(found), indent=2, allow_nan=False) + '\n')
    write_report_page(report, out / PAGE_NAME)
    return out / PAGE_NAME
