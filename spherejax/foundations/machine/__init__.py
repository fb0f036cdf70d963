"""Scalar programs as machine code that XLA calls."""
