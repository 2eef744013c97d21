"""``taxinet bench``: camera, closed loop and graph, measured in turns on one machine."""
