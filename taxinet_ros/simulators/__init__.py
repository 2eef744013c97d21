"""Other simulators as cameras (:mod:`taxinet_ros.core.renderer`) and worlds, a room for each.

They are imported only when one of their names is looked up.
"""
