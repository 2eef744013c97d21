"""``taxinet bag replay``: replay a recorded run into one node and compare its outputs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.options import BagArgument, OwnControllerOption, RunOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.core.topics import PERCEPTION, STEERING_CONTROLLER
from taxinet_ros.errors import UsageError


def replay(
    bag: BagArgument,
    into: Annotated[
        str,
        typer.Option(metavar='NODE', help='perception, steering_controller or mtl_monitor'),
    ] = 'perception',
    run_id: RunOption = None,
    perception: Annotated[
        str | None,
        typer.Option(
            help="replaces the run's perception: a word, weights file, .onnx network or "
            'FILE.py:NAME'
        ),
    ] = None,
    controller: OwnControllerOption = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='new folder for plot and table (default: below bags/)'),
    ] = None,
    tolerance_cte: Annotated[
        float,
        typer.Option(
            metavar='M', min=0, help='tolerance of cross-track estimates; 0: bit-identical'
        ),
    ] = 0.0,
    tolerance_he: Annotated[
        float,
        typer.Option(
            metavar='DEG', min=0, help='tolerance of heading estimates; 0: bit-identical'
        ),
    ] = 0.0,
) -> int:
    """Replay a recorded run into one node and compare its outputs.

    Regression test for a retrained network. Missing frames are rendered. Exit code: 0 equal within
    the tolerances, 1 different, 2 bad input, 4 the node failed.
    """
    from taxinet_ros.analysis.one_run.replay import (
        conclusion,
        differences,
        plot_replay,
        replay_lines,
        within,
        write_values,
    )
    from taxinet_ros.cli.bag.compare import DIFFERENT, EQUAL
    from taxinet_ros.core.assurance.switch import parts_of
    from taxinet_ros.core.motion.controller import STEERING
    from taxinet_ros.core.user_code import short_word
    from taxinet_ros.nodes.graph.replay import replay
    from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, new_folder
    from taxinet_ros.trials.past_runs.repeated_run import (
        controller_of,
        perception_of,
        perception_words,
        readable_run,
    )

    allowed = {'est_cte_m': tolerance_cte, 'est_he_rad': tolerance_he}
    if into != PERCEPTION and (any(allowed.values()) or perception):
        raise UsageError(
            f'--into {into}: takes neither --perception nor a tolerance; its outputs '
            'are determined exactly by its inputs'
        )
    if into != STEERING_CONTROLLER and controller:
        raise UsageError(f'--into {into}: takes no --controller')
    console = line_console()
    with readable_run(bag, run_id) as recording:
        run, trace = recording.run, recording.columns
        if run.timing.free:
            raise UsageError(
                f'{recording.path}: a free run, whose unanswered frames cannot be compared; replay '
                'a lockstep run'
            )
        word, fingerprint = run.perception, run.fingerprint
        if into == PERCEPTION:
            word, fingerprint = perception_of(run, perception)
        what = short_word(word) if into == PERCEPTION else into
        out = out or new_folder(DEFAULT_ROOT / f'replay-{run.request.run_id}-{what}')
        check_new(out)
        law = STEERING
        if into == STEERING_CONTROLLER:
            law = controller_of(run, controller)
            if parts_of(law) is not None:
                raise UsageError(
                    f'--controller {law}: its monitor needs the frames too, which are not '
                    'replayed into it; `taxinet run --from` drives the whole run again'
                )
        answers = replay(recording, run, target=into, perception=word, controller=law)
        before, now = 'recorded', 'now'
        if into == PERCEPTION:
            before += f': {perception_words(run.perception, run.fingerprint)}'
            now += f': {perception_words(short_word(word), fingerprint)}'
        found = differences(into, trace, answers)
    console.print(f'{run.request.run_id} into {into}: {before}, {now}')
    for line, style in replay_lines(found, allowed):
        console.print(line, style=style)
    out.mkdir(parents=True, exist_ok=True)
    plot_replay(
        found, trace, out / 'replay.png', title=f'{run.request.run_id} into {into}',
        recorded=before, replayed=now,
    )
    write_values(found, trace, out / 'replay.csv')
    equal = all(within(one, allowed) for one in found)
    console.print(f'{conclusion(found, equal=equal)}; picture: {out / "replay.png"}, replay.csv')
    return EQUAL if equal else DIFFERENT
