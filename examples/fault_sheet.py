"""What faults of lens and sensor look like: a sheet of pictures, as PNG or JPEG."""

import sys
import tempfile
from pathlib import Path

from PIL import Image

from taxinet_ros.analysis.camera.sheets import POSE, contact_sheet, scene_picture
from taxinet_ros.core.scenario import scenario_from_human

FAULTS = {'lens_dirt_percent': (5, 20, 50), 'glare_ghost_percent': (100,)}
FAULTS |= {'lens_drops_percent': (5, 20, 50), 'exposure_jump_ev': (-3, -1.5, 1.5, 3)}
out = Path(sys.argv[1] if sys.argv[1:] else 'fault_sheet.jpg')
scene = {**POSE, 'time_of_day_h': 10.0}
tiles = [(scene_picture(scenario_from_human(scene)), 'no fault')]
for key, level in ((key, level) for key, levels in FAULTS.items() for level in levels):
    sun_ahead = {'time_of_day_h': 7.0} if key == 'glare_ghost_percent' else {}
    picture = scene_picture(scenario_from_human({**scene, **sun_ahead, key: level}))
    tiles.append((picture, f'{key} = {level:g}{", at 7:00" if sun_ahead else ""}'))
with tempfile.TemporaryDirectory() as scratch:
    contact_sheet(tiles, 4, Path(scratch) / 'sheet.png')
    Image.open(Path(scratch) / 'sheet.png').save(out, quality=82)
print(f'sheet: {out}')
