"""``taxinet up`` and what joins it, each a process of its own, as shells start them."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from process_table import children
from waiting import wait_for

from taxinet_ros.nodes.running.domain import DISCOVERY_RANGE, LOCALHOST

TAXINET = [sys.executable, '-c', 'from taxinet_ros.cli.main import main; main()']


def environment(domain: int | None = None) -> dict[str, str]:
    """That of somebody's shell, who knows of no other graph."""
    kept = {
        name: value for name, value in os.environ.items()
        if not name.startswith(('TAXINET_', 'ROS_DOMAIN_ID'))
    }
    kept |= {DISCOVERY_RANGE: LOCALHOST, 'COLUMNS': '100'}
    return kept if domain is None else {**kept, 'ROS_DOMAIN_ID': str(domain)}


def taxinet(*words: str, cwd: Path, domain: int | None = None, **more: str) -> (
    subprocess.Popen[str]
):
    """A command under way."""
    return subprocess.Popen(
        [*TAXINET, *words], cwd=cwd, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env={**environment(domain), **more},
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, output and errors of a command, at its end."""
    try:
        output, errors = process.communicate()
    finally:
        process.kill()
    return process.returncode, output, errors


class Standing:
    """A graph that stands, and what it prints."""

    def __init__(self, folder: Path, *words: str, perception: str = 'truth') -> None:
        self.folder, self.out = folder, folder / 'up'
        self._printed, self._errors = folder / 'printed', folder / 'errors'
        with self._printed.open('w') as printed, self._errors.open('w') as errors:
            self.process = subprocess.Popen(
                [*TAXINET, 'up', '--perception', perception, '--out', 'up', *words], cwd=folder,
                env=environment(), stdout=printed, stderr=errors,
            )

    @property
    def printed(self) -> str:
        return self._printed.read_text()

    @property
    def errors(self) -> str:
        return self._errors.read_text()

    @property
    def domain(self) -> int:
        found = re.search(r'ROS domain (\d+)', self.printed)
        assert found, self.printed
        return int(found[1])

    def wait_to_say(self, words: str, times: int = 1) -> None:
        wait_for(
            lambda: self.printed.count(words) >= times or self.process.poll() is not None,
            lambda: self.printed + self.errors,
        )
        assert self.printed.count(words) >= times, self.printed + self.errors

    def pids(self) -> dict[str, int]:
        """The processes of the nodes, by module."""
        found = {}
        for pid, line in children(self.process.pid, 'taxinet_ros.nodes.').items():
            module = next(w for w in line.split() if w.startswith('taxinet_ros.nodes.'))
            found[module.rsplit('.', 1)[1]] = pid
        return found

    def sampler(self, *parameters: str, seed: int = 0, table: str = '') -> subprocess.Popen[str]:
        """A sampler in another terminal, with scenes of the program ``nominal``."""
        out = f'out:={self.folder}/{table or f"table-{seed}"}'
        words = ['program:=nominal', f'seed:={seed}', out, 'specs:=["phi_always"]', *parameters]
        options = [part for word in words for part in ('-p', word)]
        return taxinet(
            'node', 'scenario_sampler', '--ros-args', *options, cwd=self.folder, domain=self.domain
        )

    def wait_for_run(self, seed: int, sampler: subprocess.Popen[str]) -> None:
        """Until the first run of a sampler is well under way."""
        bag = self.out / f'table-{seed}-00000' / f'table-{seed}-00000_0.mcap'
        wait_for(lambda: sampler.poll() is not None or (bag.exists() and bag.stat().st_size > 2e5))
        assert sampler.poll() is None

    def ask_to_end(self, number: int = signal.SIGINT) -> int:
        self.process.send_signal(number)
        return self.process.wait()


@contextlib.contextmanager
def standing(folder: Path, *words: str, perception: str = 'truth') -> Iterator[Standing]:
    """A graph that is ready; nothing of it outlasts the ``with``."""
    graph = Standing(folder, *words, perception=perception)
    try:
        graph.wait_to_say('ready: ')
        yield graph
    finally:
        graph.process.kill()
        graph.process.wait()
