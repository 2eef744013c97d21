"""How a node runs as a process: start, parameters, domain, end."""
