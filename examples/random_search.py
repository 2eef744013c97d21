"""Custom search: draw scenes, run them, keep the worst."""

import taxinet_ros as tx  # first, so that numpy computes the same bits on every processor

# isort: split
import numpy as np

draw = np.random.default_rng(seed=1)
network = tx.load_perception('original')
worst = None
for number in range(4):
    scenario = tx.Scenario(
        cross_track_m=draw.uniform(-8, 8), heading_rad=draw.uniform(-0.3, 0.3),
        time_of_day_s=3600 * draw.uniform(6, 18), clouds=str(draw.choice(['clear', 'overcast'])),
        duration_s=12.0,
    )
    run = tx.run(scenario, perception=network, stop_on='violated')
    rho = run.rho['phi_eventually']
    print(f'run {number}: {run.outcome}, rho within {rho.lower:+.2f} to {rho.upper:+.2f}')
    if worst is None or rho.upper < worst.rho['phi_eventually'].upper:
        worst = run
print(f'worst: {worst.scenario}')
