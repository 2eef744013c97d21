"""``taxinet bag export``: export topics as tables, or the run as a film."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from taxinet_ros.cli.checked import check_new_file
from taxinet_ros.cli.options import BagArgument, RunOption
from taxinet_ros.errors import ExitCode, UsageError

if TYPE_CHECKING:
    import pandas as pd

    from taxinet_ros.bag.run.recording import Recording

TABLES = ('csv', 'parquet')
FILMS = ('mp4', 'gif')
_PICTURES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')


def export(
    bag: BagArgument,
    out: Annotated[
        Path,
        typer.Option(
            metavar='FILE|DIR', writable=True,
            help='a new .csv, .parquet, .mp4 or .gif, or a folder for a table per topic',
        ),
    ],
    topics: Annotated[
        list[str] | None,
        typer.Option(
            metavar='TOPIC',
            help='topic to export (taxi_command, …); repeatable (default: all except frames)',
        ),
    ] = None,
    file_format: Annotated[
        str | None,
        typer.Option('--format', metavar='FORMAT', help='csv, parquet, mp4 or gif'),
    ] = None,
    run_id: RunOption = None,
) -> int:
    """Export topics as tables, or the run as a film.

    A table has one row per message; nested fields become dotted column names. Without --topics, a
    single file holds the run's trace, one row per control step. The film shows the camera frames
    with error, estimate, steering and robustness interval.
    """
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.bag.run.runs import is_run_topic
    from taxinet_ros.cli.bag.input import exit_code_of
    from taxinet_ros.trials.past_runs.repeated_run import one_run

    topics = topics or []
    kind = _format(out, file_format, topics)
    check_new_file(out)
    if topics and not any(map(is_run_topic, topics)):  # Foreign topics: as recorded.
        if run_id is not None:
            raise UsageError(
                f'--run {run_id}: has no effect on --topics {topics[0]}, which belongs to no run; '
                'leave it out'
            )
        return exit_code_of(bag, lambda: _export(open_recording(bag), out, kind, topics))

    return exit_code_of(bag, lambda: _export(one_run(bag, run_id), out, kind, topics))


def _export(recording: Recording, out: Path, kind: str, topics: Sequence[str]) -> int:
    if kind in FILMS:
        return _film(recording, out, kind)
    make = _one_table if out.suffix else _tables
    return make(recording, out, kind, topics)


def _format(out: Path, named: str | None, topics: Sequence[str]) -> str:
    known = ', '.join((*TABLES, *FILMS))
    suffix = out.suffix.lower().removeprefix('.')
    kind = named or suffix or 'csv'
    if kind not in (*TABLES, *FILMS):
        raise UsageError(f'export: {kind!r} is no format; known: {known}')
    if suffix and suffix != kind:
        raise UsageError(f'--out {out}: not a {kind} file name; use {out.stem}.{kind}')
    if kind in FILMS and not suffix:
        raise UsageError(f'--out {out}: a film is a single file; use {out.name}.{kind}')
    if kind in FILMS and topics:
        raise UsageError('--topics: not for a film, which shows the whole run; leave it out')
    if kind in TABLES and suffix and len(topics) > 1:
        raise UsageError(f'--out {out}: a file holds one topic; name a folder for several')
    return kind


def _one_table(recording: Recording, out: Path, kind: str, topics: Sequence[str]) -> int:
    if topics:
        found = recording.tables(topics)
        if len(found) > 1:
            raise UsageError(f'--topics {topics[0]}: that is {", ".join(found)}; name one')
        (table,) = found.values()
    else:
        table = recording.trace
    _save(table, out, kind)
    return ExitCode.OK


def _tables(recording: Recording, out: Path, kind: str, topics: Sequence[str]) -> int:
    wanted = list(topics) or [
        topic.name for topic in recording.topics
        if topic.type not in _PICTURES and topic.encoding == 'cdr'
    ]
    tables = recording.tables(wanted)
    try:
        out.mkdir()
    except OSError as error:
        raise UsageError(f'--out {out}: cannot be created: {error.strerror}') from error
    for name, table in tables.items():
        _save(table, out / f'{name.strip("/").replace("/", ".")}.{kind}', kind)
    return ExitCode.OK


def _save(table: pd.DataFrame, path: Path, kind: str) -> None:
    from taxinet_ros.bag.run.tables import titles
    from taxinet_ros.files.atomic import make_atomically

    if kind == 'csv':
        # A CSV file has nowhere else to put units.
        titled = table.rename(columns=titles(table))
        make_atomically(path, lambda draft: titled.to_csv(draft, index=False))
    else:
        make_atomically(path, lambda draft: table.to_parquet(draft, index=False))
    print(f'table: {path} ({len(table)} rows, {len(table.columns)} columns)')


def _film(recording: Recording, out: Path, kind: str) -> int:
    from taxinet_ros.analysis.one_run.film import ACCENTS, film_frames, write_gif, write_mp4
    from taxinet_ros.core.types import rate_of

    frames, rate_hz = film_frames(recording), rate_of(recording.period_ns)
    count = write_mp4(frames, out, rate_hz) if kind == 'mp4' else (
        write_gif(frames, out, rate_hz, ACCENTS))
    print(f'film: {out} ({count} frames)')
    return ExitCode.OK
