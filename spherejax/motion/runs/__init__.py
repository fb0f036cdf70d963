"""What users call: one run, many runs, and what is remembered between calls."""
