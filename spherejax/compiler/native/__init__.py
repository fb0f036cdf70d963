"""Machine code: programs, steps of an integration and loops as functions that XLA calls, or that call each other."""
