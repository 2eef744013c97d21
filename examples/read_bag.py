"""Read a run's bag: print scenario and trace, and judge it by another requirement."""

import sys

import taxinet_ros as tx

if len(sys.argv) != 2:
    print('usage: read_bag.py BAG, a folder', file=sys.stderr)
    sys.exit(2)
recording = tx.open_recording(sys.argv[1])
for run in recording:  # a bag may hold several runs
    print(f'{run.run_id}: {run.scenario}')
    trace = run.trace
    print(f'{len(trace)} control steps, |CTE| at most {trace["cte_m"].abs().max():.2f} m')
    found = run.judge('gentle=always(abs(steering) <= 20 deg)')
    rho = found.interval
    print(f'gentle: {found.verdict}, rho {rho.lower:+.3f} to {rho.upper:+.3f}')
    commands = run.table('taxi_command')
    print(f'nose wheel at most {commands["steering_angle"].abs().max():.3f} rad')
