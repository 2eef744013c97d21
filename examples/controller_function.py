"""Run a controller written as a function, and the shipped one with other gains."""

import taxinet_ros as tx


def proportional(estimate):
    """Return nose-wheel angle [rad, left positive] and speed [m/s] for an estimate."""
    if not estimate.usable:
        return 0.0, 0.0
    return max(-0.26, min(0.26, -0.05 * estimate.cte_m - 1.2 * estimate.he_rad)), 5.0


gentle = tx.SteeringLaw(tx.SteeringGains(cte_gain_rad_per_m=0.02))
scenario = tx.Scenario(cross_track_m=6.0, heading_rad=-0.1, duration_s=20.0)
for name, controller in (('shipped', 'steering'), ('gentle', gentle), ('own', proportional)):
    run = tx.run(scenario, controller=controller)
    print(f'{name}: {run.outcome}, settled after {run.statistics.settle_time_s:.1f} s')
