"""Lower bounds of robustness while a run goes on."""
