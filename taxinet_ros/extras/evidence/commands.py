"""``taxinet evidence``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from taxinet_ros.cli.help import DefaultCommand, command_group
from taxinet_ros.cli.options import JsonOption

evidence_app = command_group(
    'Write evidence toward a requirement, all by hash, and verify it. '
    'taxinet evidence CAMPAIGN... --out DIR is short for taxinet evidence write CAMPAIGN...',
    DefaultCommand,
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
    from taxinet_ros.extras.evidence.evidence import EvidenceOptions, parse_claim
    from taxinet_ros.extras.evidence.show import run_evidence

    raise typer.Exit(run_evidence(
        EvidenceOptions(
            campaigns=tuple(campaigns), requirement=requirement, spec=spec, odd=odd,
            claim=None if claim is None else parse_claim(claim),
            localisations=tuple(localized or ()), monitors=tuple(monitor_table or ()),
            networks=tuple(perception or ()),
        ),
        out, as_json=as_json,
    ))


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
    from taxinet_ros.extras.evidence.show import run_verify
    from taxinet_ros.extras.evidence.verify import VerifyOptions

    raise typer.Exit(run_verify(
        VerifyOptions(
            folder=folder, moved=tuple(campaign or ()), networks=tuple(perception or ()),
            sample=sample, seed=seed,
        ),
        as_json=as_json,
    ))
