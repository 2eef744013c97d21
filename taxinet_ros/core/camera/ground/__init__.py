"""The ground as the camera sees it: textures, styles and projection."""
