"""Files of the program: written atomically, read strictly, with checksums."""
