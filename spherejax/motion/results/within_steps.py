"""The polynomial in time through eight instants of a step, and where a quantity is largest on it."""

from typing import Any

import jax.numpy as jnp
import numpy as np

NODES = tuple((np.polynomial.legendre.leggauss(8)[0] + 1) / 2)
"""Shares of a step at which a quantity is taken, for its peak or its zero. The state within a step is a polynomial of
degree 4 to 8 in time; with eight nodes a peak is as exact as that (four, which find the step, leave 1e-5)."""

COEFFICIENTS = np.linalg.inv(np.vander(2 * np.array(NODES) - 1))
"""Coefficients of the polynomial in s = 2x - 1 from the values at the nodes, highest power first. From -1 to
1 powers are well enough conditioned: the largest entry is 39."""

LARGEST_RISE = 0.05
"""Of a polynomial of a step above its highest node, as a share of it. More is that of one that meets a kink: the four
nodes that find the step, with a half sine between its zeros, are exceeded by less."""


def place_of_maximum(coefficients: Any, xp: Any = jnp) -> Any:
    """Where from -1 to 1 the polynomial is largest.

    Args:
        coefficients: of powers of s, highest first, shape (8,).
        xp: `jax.numpy`, or `numpy`.
    """
    slopes, bends = xp.polyder(coefficients), xp.polyder(coefficients, 2)
    grid = xp.linspace(-1.0, 1.0, 101)
    s = grid[xp.argmax(xp.polyval(coefficients, grid))]
    for _ in range(4):  # Newton, from less than half a hundredth of the step
        slope, bend = xp.polyval(slopes, s), xp.polyval(bends, s)
        s = xp.clip(s - xp.where(bend < 0, slope / xp.where(bend < 0, bend, -1.0), 0.0), -1.0, 1.0)
    return s
