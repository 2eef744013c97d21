"""A place of one's own, as a user would describe it: a runway that does not exist."""

from __future__ import annotations

from typing import Any

from taxinet_ros.core.documents import canonical

OWN: dict[str, Any] = {
    'name': 'own_16', 'time_zone': 'UTC+05:30',
    'runway': {
        'ends': [
            {'designation': '16L', 'latitude_deg': 10.018, 'longitude_deg': 77.0},
            {'designation': '34R', 'latitude_deg': 10.0, 'longitude_deg': 77.006},
        ],
        'width_m': 45, 'elevation_m': 12, 'category': 'visual', 'surface': 'concrete',
    },
}

OWN_PLACE = canonical(OWN)
"""The same, as a scenario holds it."""
