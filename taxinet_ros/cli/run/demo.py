"""``taxinet demo``: run the same scenes with both networks and with ground truth, and plot them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taxinet_ros.cli.options import OutOption, RunsOption, SeedOption

if TYPE_CHECKING:
    from taxinet_ros.analysis.camera.sheets import Picture
    from taxinet_ros.analysis.one_run.trajectories import Trajectory
    from taxinet_ros.trials.options import CampaignOptions
    from taxinet_ros.trials.record.row import RunRow

PROGRAM = 's_falsif'
PERCEPTIONS = ('original', 'taxinet', 'truth')
_SHEET_TIMES_S = (0, 3, 10)


def demo(out: OutOption = None, runs: RunsOption = 10, seed: SeedOption = 1) -> int:
    """Run ten scenes with both networks and with ground truth.

    Plots paths and camera frames.
    """
    # Violations by a network are expected, those with ground truth are failures of the demo.
    from taxinet_ros.analysis.camera.sheets import contact_sheet
    from taxinet_ros.analysis.one_run.trajectories import plot_trajectories
    from taxinet_ros.cli.run.campaign import make_campaign
    from taxinet_ros.trials.campaign import exit_code
    from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, make_options, new_folder

    out = new_folder(out or DEFAULT_ROOT / 'demo')
    check_new(out)
    columns: list[Trajectory] = []
    codes: dict[str, int] = {}
    for perception in PERCEPTIONS:
        options = make_options(
            program=PROGRAM, runs=runs, seed=seed, perception=perception, out=out / perception
        )
        engine = make_campaign(options)
        codes[perception] = exit_code(engine.summary)
        if codes[perception] > 1:
            return codes[perception]
        rows = sorted(engine.rows, key=lambda row: row.index)
        columns += trajectories(rows, options)
        if perception == PERCEPTIONS[0]:
            sheet = out / 'frames.png'
            contact_sheet(frames(rows, options), len(_SHEET_TIMES_S), sheet)
        print()
    picture = out / 'trajectories.png'
    plot_trajectories(columns, picture, f'{PROGRAM}, seed {seed}: the same scenes three times')
    print(f'pictures: {picture}, {sheet}')
    return codes['truth']


def trajectories(rows: list[RunRow], options: CampaignOptions) -> list[Trajectory]:
    """True path of every run with a bag."""
    from taxinet_ros.analysis.one_run.trajectories import Trajectory
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.core.types import NS_PER_S
    from taxinet_ros.core.verdict.outcome import Outcome

    paths = []
    for row in rows:
        if row.bag:
            recording = open_recording(options.out / row.bag)
            trace = recording.columns
            paths.append(Trajectory(
                label=options.perception,
                t_s=trace['t_ns'].astype('float64') / NS_PER_S,
                x_m=trace['distance_m'].astype('float64'),
                cte_m=trace['cte_m'].astype('float64'),
                ok=row.outcome is Outcome.PASS if row.outcome.judged else None,
                half_width_m=recording.scenario.line.half_width_m,
            ))
    return paths


def frames(rows: list[RunRow], options: CampaignOptions) -> list[tuple[Picture, str]]:
    """Captioned camera frames of every run at a few times."""
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.core.types import NS_PER_S
    from taxinet_ros.trials.summary import scene_words

    wanted = {time_s * NS_PER_S: time_s for time_s in _SHEET_TIMES_S}
    tiles = []
    for row in rows:
        if not row.bag:
            continue
        for frame in open_recording(options.out / row.bag).frames(render=False):
            if frame.stamp_ns in wanted:
                caption = f'run {row.index}, {wanted[frame.stamp_ns]} s: {row.outcome}'
                tiles.append((frame.image.copy(), f'{caption}\n{scene_words(row)}'))
    return tiles
