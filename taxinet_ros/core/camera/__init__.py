"""Camera model: ground, sky, light, rain and aircraft parts in one image."""
