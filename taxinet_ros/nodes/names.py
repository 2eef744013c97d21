"""Names of the nodes. They need no ROS, whose import takes a while."""

SIMULATOR = 'simulator'
PERCEPTION = 'perception'
STEERING_CONTROLLER = 'steering_controller'
MTL_MONITOR = 'mtl_monitor'
RECORDER = 'recorder'
SCENARIO_SAMPLER = 'scenario_sampler'
SCENE_MARKERS = 'scene_markers'

PARTICIPANTS = (PERCEPTION, STEERING_CONTROLLER, MTL_MONITOR, RECORDER)
"""Nodes that take part in the lockstep beside the simulator, which keeps it."""

CHAIN = (PERCEPTION, STEERING_CONTROLLER)
"""Nodes that answer one another within a control step."""

FOLLOWERS = (MTL_MONITOR, RECORDER)
"""Nodes that only listen, and report progress."""
