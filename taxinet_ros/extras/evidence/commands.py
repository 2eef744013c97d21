"""``taxinet evidence``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.help import command_group
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import print_json
from taxinet_ros.errors import ExitCode

_TEXT = Path(__file__).with_name('show.j2')
evidence_app = command_group(
    'Write evidence toward a requirement, all by hash, and verify it.'
)
NetworkOption = Annotated[
    list[str] | None,
    typer.Option(metavar='FILE', help="a campaign's network, if its file has moved; repeatable"),
]


@evidence_app.command('write')
def write_evidence(
    campaigns: Annotated[
        list[Path], typer.Argument(metavar='CAMPAIGN...', help='folders of finished campaigns')
    ],
    out: Annotated[Path, typer.Option(metavar='DIR', help='folder to write; must be new')],
    requirement: Annotated[
        str | None,
        typer.Option(metavar='TEXT|FILE', help="the requirement in words, 'REQ-7: The aircraft "
                     "shall …', or a file with that; the formula is that of the campaigns"),
    ] = None,
    claim: Annotated[
        str | None,
        typer.Option(metavar='SHARE', help='least share of satisfied runs that is claimed, 0.99 or '
                     '99%; supported, refuted or undetermined by the 95 % interval'),
    ] = None,
    spec: Annotated[
        str | None,
        typer.Option(metavar='NAME', help='formula of claim and ODD (default: the headline)'),
    ] = None,
    odd: Annotated[
        str | None, typer.Option(metavar='NAME|FILE.yaml', help='operational design domain: which '
                                 'of its conditions were run')
    ] = None,
    localized: Annotated[
        list[Path] | None,
        typer.Option('--localize', metavar='DIR', help='results of taxinet localize on one of the '
                     'campaigns; repeatable'),
    ] = None,
    monitor_table: Annotated[
        list[Path] | None,
        typer.Option(metavar='DIR', help='results of taxinet assure judge with the network of one '
                     'of the campaigns; repeatable'),
    ] = None,
    perception: NetworkOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write evidence toward a requirement: one page, JSON, an argument for Mermaid, a manifest.

    Binds requirement, formula, program, scenes, network, training data, tool versions and records
    by SHA-256; gives rates with intervals, ODD cells, causes and known limits. Campaigns
    that differ in program, formula or network are kept apart; damaged and unfinished ones are
    refused. Same inputs, same bytes. Exit codes: 0 written, and the claim, if any, is supported; 1
    it is refuted; 3 it is undetermined.
    """
    from rich.console import Console

    from taxinet_ros.analysis.report.text import macro_text
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.extras.evidence.argument import goals
    from taxinet_ros.extras.evidence.evidence import make_evidence, parse_claim
    from taxinet_ros.extras.evidence.inputs import read_requirement

    words = None if requirement is None else read_requirement(requirement)
    share = None if claim is None else parse_claim(claim)
    with stage_bars(Console(stderr=True)) as show:
        found = make_evidence(
            campaigns, out, show, requirement=words, claim=share, spec=spec, odd=odd,
            localisations=localized or (), monitors=monitor_table or (), networks=perception or (),
        )
    if as_json:
        print_json(found.content)
    else:
        print(macro_text(
            _TEXT, 'written', content=found.content, out=out,
            goals=goals(found.content['argument']),
            files=sorted(path.name for path in out.iterdir()),
        ))
    verdicts = {one['claim']['verdict'] for one in found.content['systems'] if one['claim']}
    raise typer.Exit(
        ExitCode.VIOLATED if 'refuted' in verdicts
        else ExitCode.INCOMPLETE if 'undetermined' in verdicts else ExitCode.OK
    )


@evidence_app.command('verify')
def verify_evidence(
    folder: Annotated[
        Path, typer.Argument(metavar='DIR', help='folder that taxinet evidence has written')
    ],
    campaign: Annotated[
        list[Path] | None,
        typer.Option(metavar='PATH', help='folder of a campaign, or of another input, that has '
                     'moved; repeatable'),
    ] = None,
    sample: Annotated[
        int, typer.Option(metavar='N', min=0, help='runs to drive again and compare to the bit')
    ] = 5,
    seed: Annotated[int, typer.Option(min=0, help='random seed that chooses them')] = 0,
    perception: NetworkOption = None,
    as_json: JsonOption = False,
) -> None:
    """Verify evidence: every byte, hash and figure again, and a sample of the runs.

    Exit codes: 0 everything holds; 2 a file or an input is damaged, missing or changed, or a figure
    is not that of its inputs; 4 a run came out differently; 3 something could not be verified.
    """
    from rich.console import Console

    from taxinet_ros.analysis.report.text import macro_text
    from taxinet_ros.cli.progress import stage_bars
    from taxinet_ros.extras.evidence.verify import verify

    with stage_bars(Console(stderr=True)) as show:
        found = verify(
            folder, moved=campaign or (), networks=tuple(perception or ()), sample=sample,
            seed=seed, on_progress=show,
        )
    if as_json:
        print_json({
            'folder': folder, 'holds': found.holds, 'checked': found.checked,
            'damaged': found.damaged, 'different': found.different,
            'unchecked': found.unchecked, 'notes': found.notes,
        })
    else:
        print(macro_text(_TEXT, 'verified', found=found, folder=folder))
        if found.damaged:
            print(f'taxinet: error: {folder}: evidence does not hold: {found.damaged[0]}',
                  file=sys.stderr)
    raise typer.Exit(found.code)
