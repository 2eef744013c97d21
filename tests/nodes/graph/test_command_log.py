"""A command that prints without end fills no disk: its log has the beginning and the end."""

from __future__ import annotations

import sys

import pytest

from taxinet_ros.nodes.graph.node_process import NodeProcess

LOUD = """
import sys
print('begun')
for k in range({lines}):
    print(f'{{k:>99}}')
sys.exit('the last line')
"""


@pytest.mark.parametrize(('lines', 'whole'), [(1000, True), (400_000, False)])
def test_given_a_command_that_prints_much_then_its_log_has_the_beginning_and_the_end(
    lines, whole, tmp_path
):
    log = tmp_path / 'log'
    command = [sys.executable, '-c', LOUD.format(lines=lines)]
    with NodeProcess.of_command('perception', command, domain=1, log=log) as process:
        assert process.wait() == 1
    text = log.read_text()
    assert text.startswith('begun\n')
    assert process.last_line() == 'the last line'
    assert f'{lines - 1:>99}\n' in text
    assert len(text) < 10_000_000
    assert ('it prints too much' in text) == ('MB are left out here' in text) == (not whole)
    assert (text.count('\n') == lines + 2) == whole
