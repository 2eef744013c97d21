"""Ground rendering: textures, styles and projection."""
