"""How often the two shipped networks satisfy phi_eventually with each fault: a table."""

import random
import sys

import taxinet_ros as tx
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.scenario_fields import BY_KEY, DRAWN_FAULTS
from taxinet_ros.trials.rates import rate

RUNS = int(sys.argv[1]) if sys.argv[1:] and sys.argv[1].isdigit() else 1
FAULTS = {'fault_onset_s': (0,), 'camera_dropout_percent': (20, 50), 'camera_freeze_s': (3,)}
FAULTS |= {'lens_dirt_percent': (5, 20, 50), 'lens_drops_percent': (5, 20, 50)}
FAULTS |= {'exposure_jump_ev': (-3, 3), 'glare_ghost_percent': (0, 100), 'loop_delay_s': (0.6,)}
FAULTS |= {'loop_jitter_s': (1.2,), 'steering_bias_deg': (5,), 'steering_rate_limit_degps': (3,)}
print('| fault | taxinet | original |\n| --- | --- | --- |')
for key, level in ((key, level) for key, levels in FAULTS.items() for level in levels):
    print(f'| {BY_KEY[key].title} {BY_KEY[key].value_words(level)} |', end=' ')
    for word in ('taxinet', 'original'):
        passed = 0
        for number in range(RUNS):
            draw = random.Random(number)  # the same starts in every cell; ghosts with the sun ahead
            scene = {'cross_track_m': draw.uniform(-8, 8), 'heading_deg': draw.uniform(-20, 20)}
            scene |= {'distance_m': draw.uniform(0, 1350), 'time_of_day_h': draw.uniform(10, 16)}
            scene |= {'fault_seed': number} if BY_KEY[key] in DRAWN_FAULTS else {}
            scene |= {'time_of_day_h': 7} if key == 'glare_ghost_percent' else {}
            scenario = scenario_from_human({**scene, key: level, 'duration_s': 20})
            passed += tx.run(scenario, perception=word).outcome == 'PASS'
        print('{:.0%} ({:.0%}-{:.0%}) |'.format(*rate(passed, RUNS)), end=' ', flush=True)
    print()
