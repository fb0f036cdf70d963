"""What a careful user would write by hand for the four-bar, in numba: equations, integrator, and other integrators."""
