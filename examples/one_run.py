"""Run one scenario; print robustness, the largest estimation error and its camera frame."""

import taxinet_ros as tx

scenario = tx.Scenario(cross_track_m=3.0, heading_rad=0.1, time_of_day_s=15 * 3600, duration_s=12.0)
run = tx.run(scenario, perception='taxinet', specs=['phi_eventually', 'on_runway'])

print(run.outcome)
for name, rho in run.rho.items():
    print(f'{name}: rho {rho.lower:+.2f}')
off_m = (run.trace['est_cte_m'] - run.trace['cte_m']).abs()
worst = int(off_m.argmax())
print(f'estimate off by at most {off_m[worst]:.2f} m, at {run.trace["t_s"][worst]:.1f} s')
print(f'that frame is {run.frame(worst).shape}, mean brightness {run.frame(worst).mean():.0f}')
