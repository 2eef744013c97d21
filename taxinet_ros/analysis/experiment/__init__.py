"""Arms of an experiment, compared scene by scene."""
