"""How runs are judged: requirements, stop rules, outcomes and statistics."""
