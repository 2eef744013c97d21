"""The domain: values, world, aircraft, camera, perception, control, monitoring.

Nothing here imports ROS, reads the wall clock, or draws from a global random generator.
"""
