"""Run a perception written as a function: the middle of the bright paint is the centreline."""

import taxinet_ros as tx


def bright_paint(image):
    """Return cross-track and heading error for a frame, (200, 360, 3) uint8 RGB, or None."""
    columns = (image[100:].min(axis=2) > 200).nonzero()[1]
    if not columns.size:
        return None
    return 10.0 * (columns.mean() / 360 - 0.5), 0.0  # metres and radians, left positive


scenario = tx.Scenario(cross_track_m=2.0, duration_s=8.0)
for perception in ('truth', 'taxinet', bright_paint):
    run = tx.run(scenario, perception=perception, specs='phi_eventually')
    seen = 100 * run.trace['est_valid'].mean()
    print(f'{getattr(perception, "__name__", perception)}: {run.outcome}, frames seen {seen:.0f} %')
