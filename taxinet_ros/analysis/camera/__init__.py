"""Camera pictures: contact sheets, and comparisons of our frames with real ones."""
