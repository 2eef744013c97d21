"""What a campaign is, written down before its first run: in ``campaign.json`` and the ledger."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taxinet_ros import __version__
from taxinet_ros.bag.layout import write_atomically
from taxinet_ros.campaign.options import CampaignOptions, check_new
from taxinet_ros.campaign.programs import program_digest, program_text
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import parse_spec

FACTS_NAME = 'campaign.json'
LEDGER_NAME = 'ledger.jsonl'


def campaign_facts(options: CampaignOptions, program: Path) -> dict[str, Any]:
    """All that a campaign's runs depend on, in plain values.

    Args:
        options: what was asked for.
        program: the Scenic program's file.
    """
    specs = [parse_spec(text) for text in options.specs]
    return {
        'taxinet_ros_version': __version__,
        'program': program.name,
        'program_sha256': program_digest(program),
        'program_text': program_text(program),
        'runs': options.runs,
        'seed': options.seed,
        'perception': options.perception,
        'overrides': dict(options.overrides),
        'laid_over': dict(options.laid_over),
        'gains': dict(options.gains),
        'specs': {spec.name: str(spec.formula) for spec in specs},
        'stop_on': options.stop_on,
        'bounds': list(options.bounds),
        'rates': list(options.rates),
        'processes': options.processes,
        'images': options.images,
    }


def make_folder(out: Path, facts: Mapping[str, Any]) -> None:
    """Begin a campaign's folder, which must be new or empty.

    Raises:
        UsageError: it is not, or it cannot be made.
    """
    check_new(out)
    write_facts(out, facts)


def write_facts(out: Path, facts: Mapping[str, Any]) -> None:
    """Write ``campaign.json``, making the folder where needed.

    Raises:
        UsageError: it cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        write_atomically(out / FACTS_NAME, json.dumps(facts, indent=2) + '\n')
    except OSError as error:
        raise UsageError(f'--out {out}: cannot be written: {error.strerror}') from error
