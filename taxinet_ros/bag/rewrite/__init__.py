"""Write new bags from old ones: recover, split, render frames."""
