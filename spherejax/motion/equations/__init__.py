"""What follows from a state: accelerations, reactions, what is observed, and the programs of them."""
