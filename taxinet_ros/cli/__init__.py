"""The command line: one program, ``taxinet``."""
