"""``taxinet falsify --objective``: what is printed about the rules."""

from __future__ import annotations

from pathlib import Path

from taxinet_process import taxinet

import taxinet_ros as tx


def test_given_a_rulebook_when_searched_then_the_summary_names_the_runs_that_break_each_rule(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'found'
    done = taxinet(
        'falsify', 's_falsif', '--perception', 'truth', '--sampler', 'active', '--runs', '6',
        '--seed', '7', '--set', 'duration=2', '--images', 'none', '--engine', 'loop', '--audit',
        '0', '--spec', 'near=always(abs(cte) <= 6)', '--spec', 'slow=always(speed <= 90)',
        '--objective', 'slow, near', '--out', out,
    )
    assert done.returncode == 1, done.stderr
    rows = tx.open_campaign(out).rows
    broken = [str(index) for index in rows.index[rows['rho_near'] <= 0]]
    assert 0 < len(broken) < 6
    lines = done.stdout.splitlines()
    assert f'near: broken in {len(broken)} runs ({", ".join(broken)})' in lines
    assert 'slow: broken in 0 runs' in lines
