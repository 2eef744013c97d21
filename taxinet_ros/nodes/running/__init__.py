"""Running a node as a process: start, parameters, domain, shutdown."""
