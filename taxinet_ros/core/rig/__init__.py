"""What is simulated, as data: the aircraft and the camera on it, from YAML files and scenarios."""
