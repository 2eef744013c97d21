"""``ros2 taxinet …``: the executable ``taxinet`` as a command of ros2cli, found by its entry point.

A module outside the package, because ``ros2 --help`` imports it into a process that has numpy
already, which taxinet_ros would have to come before.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix


class TaxinetCommand:
    """Test vision-based aircraft taxiing in closed loop, with the words of taxinet."""

    def add_arguments(self, parser: argparse.ArgumentParser, cli_name: str) -> None:
        """Take every word as it stands, ``--help`` too: none of them is an option of ros2."""
        parser.prefix_chars = '\0'
        parser.add_argument('words', nargs=argparse.REMAINDER)

    def main(self, *, parser: argparse.ArgumentParser, args: argparse.Namespace) -> int:
        """Become ``taxinet WORDS…``, as ``ros2 run taxinet_ros taxinet WORDS…`` starts it."""
        try:
            program = Path(get_package_prefix('taxinet_ros'), 'lib', 'taxinet_ros', 'taxinet')
            os.execv(program, ['taxinet', *args.words])
        except (PackageNotFoundError, OSError) as error:
            print(f'error: cannot start taxinet: {error}', file=sys.stderr)
            return 2
