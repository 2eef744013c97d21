"""Stands in for ``taxinet``: leaves behind what a stage's command would, in no time.

What it was asked goes to ``asked.txt``. ``fail.txt`` names a folder at which it fails with exit
code 2; ``wait.txt`` one at which it waits for Ctrl-C, with half of its ledger written;
``flawless.txt`` a campaign without failures. It imports nothing that takes time.
"""

from __future__ import annotations

import json
import shutil
import signal
import sys
from pathlib import Path


def main(words: list[str]) -> int:
    """Do as if."""
    with Path('asked.txt').open('a') as file:
        file.write(' '.join(words) + '\n')
    out = Path(words[words.index('--out') + 1])
    folder = out.parent if out.suffix else out
    if folder.name and named('fail.txt') == folder.name:
        print(f'taxinet: error: {folder.name}: out of luck', file=sys.stderr)
        return 2
    if words[0] == 'falsify' or words[0] == 'experiment':
        if (folder / 'ledger.jsonl').exists() != ('--resume' in words):
            return 2
        (folder / 'ledger.jsonl').write_text('half\n')
    if folder.name and named('wait.txt') == folder.name:
        signal.signal(signal.SIGINT, lambda *_: sys.exit(130))
        print('waiting', flush=True)
        signal.pause()
    return leave(words, out, folder)


def leave(words: list[str], out: Path, folder: Path) -> int:
    """Write the files that the stage has to leave behind."""
    if words[0] == 'train':
        out.write_text(f'weights of {" ".join(words)}')
        out.with_suffix('.json').write_text('{}')
    elif words[0] == 'falsify':
        campaign(words, folder)
        return 1
    else:
        names = {
            'analyze': ('analysis.json', 'report.html'),
            'localize': ('localize.json', 'localize.parquet'),
            'experiment': ('experiment.json', 'pairs.parquet'),
            'case-study': ('report/case_study.html', 'report/case_study.json',
                           'report/networks.parquet'),
        }[words[0]]
        for name in names:
            (folder / name).parent.mkdir(exist_ok=True)
            (folder / name).write_text(json.dumps({'asked': words}))
    return 0


def campaign(words: list[str], folder: Path) -> None:
    """A table of as many runs as were asked for; half of them failed, or none."""
    runs = words[words.index('--runs') + 1]
    kind = 'flawless' if named('flawless.txt') == folder.name else 'half'
    shutil.copy(f'{kind}-{runs}.parquet', folder / 'runs.parquet')
    for name in ('learned.json', 'learned.scenic') if kind == 'half' else ():
        (folder / name).write_text('model runway_world\n')


def named(file: str) -> str:
    """What a file in this folder names, '' where there is none."""
    path = Path(file)
    return path.read_text() if path.exists() else ''


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
