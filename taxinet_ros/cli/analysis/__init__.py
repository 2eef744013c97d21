"""Analysis commands: analyze, explain, gate, localize, monitor, spec."""
