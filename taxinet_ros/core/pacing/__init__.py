"""When answers take effect: latencies, late frames, free runs."""
