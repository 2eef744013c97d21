"""Process handling: children, pools, signals and exit codes."""
