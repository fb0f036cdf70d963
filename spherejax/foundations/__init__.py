"""Names for arrays, guarded numerics, rotations, and the scalar program."""
