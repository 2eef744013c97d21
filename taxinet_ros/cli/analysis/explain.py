"""``taxinet explain``: explain why the network failed in one recorded run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.options import ExaminedOption, JsonOption, RunOption
from taxinet_ros.cli.show import line_console, print_json
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.facts import RecordedRun
    from taxinet_ros.core.renderer import ChosenRenderer



def explain(
    bag: Annotated[
        Path, typer.Argument(metavar='BAG', help='folder of a run, usually a counterexample')
    ],
    run_id: RunOption = None,
    perception: Annotated[
        str | None,
        typer.Option(metavar='WORD|FILE', help="network to examine (default: the run's)"),
    ] = None,
    frames: Annotated[
        int,
        typer.Option(
            min=1, max=20, help='maximum number of frames to examine: the worst ones and the first'
        ),
    ] = 4,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar='NAME|FILE',
            help="the run's camera, if that is not ours: asked for pictures of the changed scenes "
            '(default: they are not changed)',
        ),
    ] = None,
    spec: ExaminedOption = None,
    out: Annotated[
        Path | None, typer.Option(help='output folder for page and images; must be new')
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Explain why the network failed in one run.

    Shows where its estimates are wrong, and what it would estimate at the worst moments without
    shadow, crossing or rain, under another sky and at another hour.
    """
    from taxinet_ros.analysis.explain.explain import explain
    from taxinet_ros.analysis.explain.report import explain_report, write_explanation
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.core.perception.perception import make_perception
    from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, make_out, new_folder
    from taxinet_ros.trials.past_runs.repeated_run import readable_run

    console = line_console(stderr=as_json)
    with readable_run(bag, run_id) as recording:
        run = recording.run
        word = _network(run, perception)
        renderer = _renderer(run, camera)
        out = out or new_folder(DEFAULT_ROOT / f'explain-{run.request.run_id}')
        check_new(out)
        with stage_bars(console) as show:
            found = explain(
                recording, make_perception(word), frames=frames,
                on_progress=show, renderer=renderer, spec=spec,
            )
    make_out(out)
    page, values = write_explanation(found, out)
    if as_json:
        print_json(values)
        return ExitCode.OK
    console.print(f'{run.request.run_id}, network {word}')
    for sentence in explain_report(found).summary:
        console.print(sentence)
    console.print(f'page: {page}')
    return ExitCode.OK


def _network(run: RecordedRun, asked: str | None) -> str:
    """Word or file of the network to examine; by default the run's own, if available."""
    from taxinet_ros.trials.past_runs.repeated_run import perception_of

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
    from taxinet_ros.core.renderer import find_renderer
    from taxinet_ros.core.world import world_and_camera
    from taxinet_ros.registry import KMWH

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
