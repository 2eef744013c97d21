"""Commands that analyse: analyze, explain, gate, localize, monitor, spec."""
