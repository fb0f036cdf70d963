"""Linear systems of known structure: array code, and the same as an unrolled scalar program."""
