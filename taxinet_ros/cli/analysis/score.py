"""``taxinet score``: networks on recordings of a real aircraft."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from taxinet_ros.cli.completion import complete_perception, complete_spec, one_of
from taxinet_ros.cli.options import JsonOption, MonitorOption, ScenarioOption
from taxinet_ros.cli.show import line_console, print_json, print_table
from taxinet_ros.core.user_code import COMMAND
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from taxinet_ros.recordings.score import Score
    from taxinet_ros.recordings.truth import TruthSource


def score(
    bags: Annotated[
        list[Path], typer.Argument(metavar='BAG…', help='folders or files of rosbag2 recordings')
    ],
    place: Annotated[
        str, typer.Option(help='where it was: a name or file, as `taxinet place` takes; default: '
        'that of a run of ours')
    ] = '',
    image: Annotated[
        str, typer.Option(metavar='TOPIC', help='Image or CompressedImage; default: the only one; '
                          'none: recorded estimates count at their own stamps')
    ] = '',
    truth: Annotated[
        str,
        typer.Option(
            metavar='TOPIC', help='NavSatFix, Odometry or PoseStamped, or /tf:PARENT:CHILD; '
            'default: the only one'
        ),
    ] = '',
    heading: Annotated[
        str,
        typer.Option(
            metavar='TOPIC', help='Imu, Odometry or PoseStamped with the heading, or track: the '
            'direction of motion (the default of NavSatFix)'
        ),
    ] = '',
    heading_is: Annotated[
        str,
        typer.Option(
            metavar='KIND', help='enu: counter-clockwise from east (REP-103); compass: clockwise '
            'from north', autocompletion=one_of('enu', 'compass'),
        ),
    ] = 'enu',
    heading_offset: Annotated[
        float, typer.Option(metavar='DEG', help='added to the heading, clockwise')
    ] = 0.0,
    frame: Annotated[
        str,
        typer.Option(
            metavar='WHERE', help='frame of poses: runway, or LAT,LON of the origin of an '
            'east-north-up frame'
        ),
    ] = '',
    antenna: Annotated[
        str,
        typer.Option(
            metavar='X,Y', help="what the truth is the place of, from the aircraft's reference "
            'point [m]: forward, left'
        ),
    ] = '0,0',
    track: Annotated[
        str, typer.Option(help='line that errors are measured from: runway, or one of the place')
    ] = '',
    camera: Annotated[
        str, typer.Option(help='the camera: a name or a YAML file (docs/world.md), for networks '
        'and monitors that have to know it')
    ] = '',
    aircraft: Annotated[
        str, typer.Option(help='the aircraft that carries it (default: caravan)')
    ] = '',
    perception: Annotated[
        str,
        typer.Option(
            metavar='NET', help='a network, as `taxinet run` takes; or /TOPIC of the bag with '
            'recorded estimates: of TrackingError, or as /TOPIC:FIELD=m,FIELD=rad of any type '
            '(units: ft, deg, …; left positive, a minus before a field turns it)',
            autocompletion=complete_perception,
        ),
    ] = 'taxinet',
    against: Annotated[
        str | None, typer.Option(metavar='NET', help='a second one, compared frame by frame',
                                 autocompletion=complete_perception)
    ] = None,
    latency: Annotated[
        str,
        typer.Option(
            metavar='SECONDS', help='by how much the stamps of the pictures are late, to be taken '
            'off; or estimated'
        ),
    ] = '',
    stamps: Annotated[
        str,
        typer.Option(
            metavar='WHICH', help='header: when messages were made; log: when they were recorded',
            autocompletion=one_of('header', 'log'),
        ),
    ] = 'header',
    spec: Annotated[
        list[str] | None,
        typer.Option(
            '--spec', metavar='FORMULA', help='requirement on the recorded path (default: '
            'phi_always and phi_eventually, which do not change the exit code); repeatable',
            autocompletion=complete_spec,
        ),
    ] = None,
    monitor: MonitorOption = None,
    topics: Annotated[
        bool, typer.Option('--topics', help='list the topics and what each can be used for')
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(help='new folder for frames.parquet, score.json and the page score.html'),
    ] = None,
    simulate: Annotated[
        bool, typer.Option('--simulate', help='also render the recorded poses in our world, and '
                           'show them to the same network')
    ] = False,
    settings: ScenarioOption = None,
    metar: Annotated[
        str, typer.Option(metavar='TEXT', help='weather of the rendered frames')
    ] = '',
    dataset: Annotated[
        Path | None,
        typer.Option(metavar='DIR', help='also write labelled images of the scored frames, thinned '
                     'to one a metre, a folder for each recording: for `taxinet train --add`')
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Score networks on recordings: errors against where the aircraft really was.

    Takes any rosbag2 with pictures and positions; docs/recordings.md. Exit codes: 0 scored, and
    every --spec is satisfied; 1 one is violated; 2 bad input; 3 one is unclear, as a
    stretch of the recorded path does not decide it.
    """
    if topics:
        return _list_topics(bags, as_json)
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.recordings.report import score_json, score_report, write_score
    from taxinet_ros.recordings.score import ScoreOptions
    from taxinet_ros.recordings.score import score as score_bags
    from taxinet_ros.trials.options import check_new

    options = ScoreOptions(
        bags=tuple(bags), perception=perception, against=against or '',
        place=place, track=track, image=image, camera=camera, aircraft=aircraft, latency=latency,
        specs=tuple(spec or ()), monitor=monitor or '', dataset=dataset, source=_source(
            truth, heading, heading_is, heading_offset, frame, antenna, stamps),
    )
    if out is not None:
        check_new(out)
    _check_rendered(simulate, options.perception, {'--set': settings, '--metar': metar})
    with stage_bars(Console(stderr=True)) as show:
        found = score_bags(options, show, _player() if perception.startswith(COMMAND) else None)
    if simulate:
        _simulate(found, settings or [], metar)
    if out is None:
        report = score_report(found)
        values = score_json(found, report)
    else:
        report, values = write_score(found, out)
    if as_json:
        print_json(values)
    else:
        _print(found, report.summary, out)
    if dataset is not None:
        from taxinet_ros.recordings.dataset import write_datasets

        for folder, count in write_datasets(found, dataset).items():
            line_console(stderr=as_json).print(
                f'{count} labelled images: {folder}' + ('' if found.setup.rig else '; of no known '
                'camera, which networks with a view ask for: give --camera'))
    verdicts = {one.verdict for one in found.verdicts} or {'UNCLEAR'}
    if not spec or verdicts == {'SATISFIED'}:
        return ExitCode.OK
    return ExitCode.VIOLATED if 'VIOLATED' in verdicts else ExitCode.INCOMPLETE


def _check_rendered(simulate: bool, perception: str, weather: dict[str, Any]) -> None:
    """Refuse to render without a network that sees it, and weather without rendering."""
    from taxinet_ros.recordings.estimates import names_topic

    if not simulate:
        for option in (name for name, value in weather.items() if value):
            raise UsageError(f'{option}: needs --simulate')
        return
    if perception.startswith(COMMAND):
        raise UsageError(f'--simulate: not with {perception}; play it into the node in a graph')
    if names_topic(perception):
        raise UsageError(f'--simulate: the estimates on {perception} are not of rendered frames; '
                         'name their network')


def _player() -> Any:
    from taxinet_ros.nodes.graph.replay import play_pictures

    return play_pictures


def _simulate(found: Score, settings: list[str], metar: str) -> None:
    from taxinet_ros.recordings.rendered import metar_weather, render_beside, start_scenario
    from taxinet_ros.trials.options import read_settings

    weather, unshown = metar_weather(metar) if metar else ({}, [])
    if unshown:
        found.notes.append(f'--metar: {" ".join(unshown)} is not shown by our world')
    render_beside(found, start_scenario(found, {**weather, **read_settings(settings)}))


def _source(
    truth: str, heading: str, heading_is: str, heading_offset: float, frame: str, antenna: str,
    stamps: str,
) -> TruthSource:
    from taxinet_ros.recordings.truth import RUNWAY, TRACK, TruthSource, origin_of

    if heading_is not in ('enu', 'compass'):
        raise UsageError(f'--heading-is {heading_is}: expected enu or compass')
    if stamps not in ('header', 'log'):
        raise UsageError(f'--stamps {stamps}: expected header or log')
    try:
        ahead, left = map(float, antenna.split(','))
    except ValueError:
        ahead = left = math.nan
    if not (abs(ahead) <= 50 and abs(left) <= 50):
        raise UsageError(f'--antenna {antenna!r:.40}: expected X,Y in metres: forward, left')
    if heading == TRACK and (heading_offset or heading_is != 'enu'):
        raise UsageError('--heading track: the direction of motion has no convention or offset')
    if frame not in ('', RUNWAY):
        origin_of(frame)
    return TruthSource(
        topic=truth, heading=heading, frame=frame, compass=heading_is == 'compass',
        heading_offset_rad=math.radians(heading_offset), antenna_m=(ahead, left),
        by_log=stamps == 'log',
    )


def _list_topics(bags: list[Path], as_json: bool) -> int:
    from taxinet_ros.recordings.frames import proposals

    found = {str(bag): proposals(bag) for bag in bags}
    if as_json:
        print_json(found)
        return ExitCode.OK
    for bag, topics in found.items():
        print(bag)
        widths = [max(len(str(topic[name])) for topic in topics) for name in topics[0]]
        for topic in topics:
            cells = (f'{word:<{width}}' for word, width in zip(
                map(str, topic.values()), widths, strict=True))
            print(f'  {"  ".join(cells)}'.rstrip())
    return ExitCode.OK


def _print(found: Score, sentences: tuple[str, ...], out: Path | None) -> None:
    from taxinet_ros.recordings.report import PAGE_NAME

    console = line_console(width=130)
    for sentence in sentences:
        console.print(sentence)
    headings, numbers = ['', 'frames'], range(len(found.networks))
    for number in numbers:
        end = f' {number + 1}' if len(numbers) > 1 else ''
        headings += [f'cross-track{end} [m]', f'heading{end} [deg]']
    print_table(console, headings, [
        (one.name if one.kind == 'all' else f'{one.kind} {one.name}',
         str(one.errors['cte'][0].frames),
         *(_mean_words(means[number]) for number in numbers for means in one.errors.values()))
        for one in found.slices
    ])
    if out is not None:
        console.print(f'page: {out / PAGE_NAME}')


def _mean_words(mean: Any) -> str:
    if math.isnan(mean.value):
        return '-'
    around = '' if math.isnan(mean.low) else f' ({mean.low:.2f} to {mean.high:.2f})'
    return f'{mean.value:.2f}{around}'
