"""Report of a study, compared with the paper."""
