"""``taxinet monitor``: judges recorded runs, without ROS, and draws what was known when."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import accumulate
from pathlib import Path

from rich.console import Console
from rich.text import Text

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.judged_bag import JudgedBag, judged_spec, signals_of
from taxinet_ros.bag.judged_bags import judge_bags
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.bag.recorded_run import read_run
from taxinet_ros.bag.run_samples import read_run_samples
from taxinet_ros.bag.runs import read_recording
from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.campaign.judged_run import BagPlaces
from taxinet_ros.campaign.lines import check_lines
from taxinet_ros.campaign.options import check_assumptions
from taxinet_ros.campaign.requirements import add_requirements, addable, campaign_bags
from taxinet_ros.campaign.spec_files import read_specs
from taxinet_ros.cli.monitor_lines import as_document, bag_lines, summary_lines
from taxinet_ros.cli.progress import stage_bars
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import Assumptions, Spec, parse_spec
from taxinet_ros.core.spec_check import SpecCheck, describe_specs
from taxinet_ros.core.steering import SteeringGains

VIOLATED, LOSSY = 1, 3
_PICTURE = '.png'


def run_monitor(
    places: Sequence[Path], *, specs: Iterable[str], plot: Path | None, add: bool, as_json: bool,
    workers: int, bounds: Sequence[str] = (), rates: Sequence[str] = (), run: str | None = None,
) -> int:
    """Judge bags and print what they say.

    Args:
        places: run folders, ``.mcap`` files, or folders of campaigns.
        specs: requirements as text or files of them; where empty, each bag's own.
        plot: PNG file, or where there are several bags a folder, to draw to.
        add: put the requirements into the tables of the campaigns.
        as_json: print one JSON document.
        workers: processes that judge.
        bounds: what is vouched for of the signals' values; without any, and without rates, what
            each bag says was.
        rates: of their change per second.
        run: which run of the one bag that is named; all of them where None.

    Returns:
        Exit code: 1 where a run violates a requirement in a bag that holds several; 3 where a bag
        is incomplete, damaged, or contradicts what was recorded in it; else 1 where a requirement
        is violated; else 0.

    Raises:
        UsageError: bad input.
        InfraError: a worker process died.
    """
    chosen = [parse_spec(text) for text in read_specs(specs)]
    vouched = check_assumptions(bounds, rates) if bounds or rates else None
    found = {place: _bags(place) for place in places}
    bags = list(dict.fromkeys(bag for group in found.values() for bag in group))
    if run is not None and len(bags) > 1:
        raise UsageError(f'--run {run}: there are {len(bags)} bags; name the one that holds it')
    to_add = {place: addable(place, chosen) for place in places} if add else {}
    if add and not chosen:
        raise UsageError('--add: say with --spec which requirement to add')
    told = _Told(chosen)
    if plot is not None:
        _check_plot(plot, bags)
    judged = _judged(
        bags, chosen, workers, vouched, as_json=as_json, named=places, run=run, told=told,
    )
    if plot is not None:
        _check_one(plot, judged)
    notes = []
    for place, new in to_add.items():
        counts = add_requirements(place, new, {bag.path: bag for bag in judged if not bag.run})
        notes += [f'{place}: rho_{name} added for {count} runs' for name, count in counts.items()]
    if plot is not None:
        notes += [f'picture: {_draw(bag, vouched, plot)}' for bag in judged
                  if bag.verdicts and bag.end_s >= 0]
    if as_json:
        print(as_document(judged, told.warnings))
    else:
        lines = summary_lines(judged) if len(judged) > 1 else []
        for line in (*lines, *notes):
            Console(highlight=False).print(line, soft_wrap=True, markup=False)
    return _exit_code(judged)


def _bags(place: Path) -> list[Path]:
    """The bags at a place that the user named."""
    if place.is_file():
        return [place]
    if not place.is_dir():
        raise UsageError(f'{place}: no such bag; give a run folder, an .mcap file or a campaign')
    # What is compressed, or of another storage, is to be refused by name.
    if any(path for kind in (f'*.{STORAGE_ID}*', '*.db3') for path in place.glob(kind)):
        return [place]
    bags = campaign_bags(place)
    if not bags:
        what = 'no run of it left a bag' if (place / LEDGER_NAME).is_file() else 'holds no bag'
        raise UsageError(f'{place}: {what}')
    return bags


def _judged(
    bags: Sequence[Path], specs: Sequence[Spec], workers: int, vouched: Assumptions | None, *,
    as_json: bool, named: Sequence[Path], run: str | None, told: _Told,
) -> list[JudgedBag]:
    """Judge all of them, and print each as soon as it is known."""
    console = Console(highlight=False, stderr=as_json)
    chosen = None if run is None else read_recording(bags[0]).choose(run).name
    judged: list[JudgedBag] = []
    places = BagPlaces()
    with stage_bars(console) as show:
        for bag in judge_bags(bags, specs, workers, vouched):
            if bag.foreign and bag.path in named:
                raise UsageError(bag.trouble)
            if chosen is not None and bag.run not in ('', chosen):
                continue
            if bag.verdicts and not bag.run:
                places.check(bag.path, whole=not bag.trouble)
            judged.append(bag)
            news = told.of(bag)
            if not as_json:
                for line in (*news, *bag_lines(bag)):
                    console.print(line, soft_wrap=True)
            if len(bags) > 1:
                show('judging', len({one.path for one in judged}), len(bags))
    if not judged:
        raise UsageError(f'--run {run}: there is not one step of it in {bags[0]}')
    return judged


class _Told:
    """Says of each requirement once how it is understood, and of each length of run what to mind.

    Attributes:
        warnings: all that there were.
    """

    def __init__(self, specs: Sequence[Spec]) -> None:
        self.warnings: list[str] = []
        self._specs = specs
        self._lengths_s: set[float] = set()

    def of(self, bag: JudgedBag) -> list[Text]:
        """What is to be said before the verdicts of a bag."""
        if bag.duration_s in self._lengths_s or not bag.duration_s > 0:
            return []
        found = describe_specs(self._specs, bag.duration_s, _gains(bag.path))
        new = tuple(line for line in found.warnings if line not in self.warnings)
        self.warnings += new
        lines = check_lines(SpecCheck(lines=found.lines, warnings=new), quiet=bool(self._lengths_s))
        self._lengths_s.add(bag.duration_s)
        return lines


def _gains(bag: Path) -> SteeringGains | None:
    """Those that a bag tells of; None where it cannot, so that nobody knows who steered."""
    try:
        return SteeringGains(**read_run(bag).gains)
    except (BagError, UsageError):
        return None


def _exit_code(bags: Iterable[JudgedBag]) -> int:
    judged = list(bags)
    violated = [bag for bag in judged if any(one.verdict.failed for one in bag.verdicts)]
    # A recording of several runs mostly ends amid the last one, which unsays nothing of the others.
    # Nor does a topic that is missing unsay what others tell: damage leaves no verdict at all.
    if any(bag.run or bag.trouble for bag in violated):
        return VIOLATED
    if not all(bag.sound for bag in judged):
        return LOSSY
    return VIOLATED if violated else 0


def _check_plot(plot: Path, bags: Sequence[Path]) -> None:
    if plot.suffix == _PICTURE and len(bags) > 1:
        raise UsageError(f'--plot {plot}: there are {len(bags)} bags; name a folder')
    if plot.suffix not in ('', _PICTURE):
        raise UsageError(f'--plot {plot}: write NAME.png, or name a folder')
    folder = plot.parent if plot.suffix else plot
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'--plot {plot}: cannot be written: {error.strerror}') from error


def _check_one(plot: Path, judged: Sequence[JudgedBag]) -> None:
    if plot.suffix == _PICTURE and len(judged) > 1:
        names = ', '.join(bag.run or bag.name for bag in judged)
        raise UsageError(f'--plot {plot}: the bag holds {names}; name a folder, or one with --run')


def _draw(bag: JudgedBag, vouched: Assumptions | None, plot: Path) -> Path:
    from taxinet_ros.analysis.robustness_picture import JudgedSpec, robustness_picture

    specs = [one.spec for one in bag.verdicts]
    runs = read_run_samples(bag.path, signals_of(specs))
    samples = next(one for one in runs if one.run == bag.run)
    judged = []
    for spec in specs:
        verdict, readings = judged_spec(samples, spec, vouched)
        # Where a topic that it reads is missing, no more is known than before.
        at = dict(zip(samples.seen_by(spec).stamps_ns, readings, strict=False))
        known = accumulate(
            (at.get(stamp) for stamp in samples.stamps_ns), lambda old, new: new or old,
            initial=readings[0],
        )
        judged.append(JudgedSpec(verdict=verdict, readings=[*known][1:]))
    path = plot if plot.suffix else plot / f'{_file_name(bag)}{_PICTURE}'
    try:
        robustness_picture(
            samples.stamps_ns, samples.samples, judged, path, title=_title(bag),
            end_s=bag.duration_s,
        )
    except OSError as error:
        raise UsageError(f'--plot {path}: cannot be written: {error.strerror}') from error
    return path


def _file_name(bag: JudgedBag) -> str:
    return re.sub(r'[^A-Za-z0-9_.-]+', '_', bag.name)


def _title(bag: JudgedBag) -> str:
    if bag.end_s >= bag.duration_s:
        return bag.name
    why = 'stopped early' if bag.stopped_early else 'incomplete'
    return f'{bag.name}   ({why}: {bag.end_s:g} of {bag.duration_s:g} s)'
