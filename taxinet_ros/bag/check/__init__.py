"""What is said of a bag: storage, lockstep, verdicts, and whether two bags are the same."""
