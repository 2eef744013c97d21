"""The camera: ground, sky, light, rain and the parts of the aircraft in one picture."""
