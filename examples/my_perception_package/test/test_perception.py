"""Does the node keep to the contract, and how well does it drive? ``pytest``, ``colcon test``."""

import os
import sys

from taxinet_ros.testing import check_perception

NODE = f'cmd:{sys.executable} -m my_perception_package.perception'
SCENES = int(os.environ.get('SCENES', '50'))


def test_the_node_keeps_to_the_contract():
    check_perception(NODE)


def test_the_node_keeps_the_aircraft_on_the_runway(taxinet_campaign):
    campaign = taxinet_campaign(
        's_falsif', perception=NODE, runs=SCENES, at_least=0.9, specs=['on_runway'],
        settings={'duration': 3},
    )
    assert campaign.rates['failed'].rate.high < 0.9  # the upper end of the 95 % interval
