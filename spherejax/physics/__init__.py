"""Bodies, laws, joints and forces: what the equations say, one contact at a time."""
