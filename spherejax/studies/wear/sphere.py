"""A map of a sphere: n times n cells of equal area, numbers between their centers, and deposits that lose nothing.

The sphere is folded onto an octahedron and that onto a square, so that equal areas stay equal. There is no pole where
cells become small. Neighbors across the square's border are known in closed form: it is folded in the middle of each
side.

Source: Clarberg (2008), Fast equal-area mapping of the (hemi)sphere using SIMD, J. Graphics Tools 13(3):53-68.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from spherejax.foundations.types import Numeric


def cell_solid_angle(n: int) -> float:
    """Of each cell [sr]."""
    return 4 * np.pi / (n * n)


def cell_width(n: int) -> float:
    """Side of a square of a cell's area [rad]."""
    return float(np.sqrt(cell_solid_angle(n)))


def centers(n: int) -> Float[np.ndarray, "n n 3"]:
    """Unit vectors to the centers of the cells."""
    place = (2 * np.arange(n) + 1) / n - 1
    a, b = np.meshgrid(place, place, indexing="ij")
    d = 1 - np.abs(a) - np.abs(b)
    r = 1 - np.abs(d)
    phi = ((np.abs(b) - np.abs(a)) / np.where(r > 0, r, 1.0) + 1) * np.pi / 4
    across = r * np.sqrt(2 - r * r)
    x, y = np.copysign(across * np.cos(phi), a), np.copysign(across * np.sin(phi), b)
    return np.stack([x, y, np.copysign(1 - r * r, d)], axis=-1)


def on_the_square(u: Numeric) -> Float[Array, "q 2"]:
    """Places of unit vectors on the square [-1, 1]^2.

    Limits: continuous everywhere but at u = -z, whose four places are the corners.
    """
    x, y, z = u[..., 0], u[..., 1], u[..., 2]
    across = x * x + y * y
    # sqrt(1 - |z|) without its loss of digits near the poles.
    r = jnp.sqrt(across / (1 + jnp.abs(z)))
    b = r * jnp.arctan2(jnp.abs(y), jnp.abs(x)) * (2 / jnp.pi)
    a = r - b
    below = z < 0
    a, b = jnp.where(below, 1 - b, a), jnp.where(below, 1 - a, b)
    return jnp.stack([jnp.where(x < 0, -a, a), jnp.where(y < 0, -b, b)], axis=-1)


def corners(u: Numeric, n: int) -> tuple[Int[Array, "q 4"], Float[Array, "q 4"]]:
    """The four cells around unit vectors, as flat indices, and their weights: positive, with the sum 1.

    With them numbers are interpolated, and deposits shared out: what is deposited is all there, however coarse the map.
    """
    place = (on_the_square(u) + 1) * (n / 2) - 0.5
    low = jnp.floor(place)
    share = place - low
    i, j = low[..., 0].astype(int), low[..., 1].astype(int)
    s, t = share[..., 0], share[..., 1]
    cells = [_folded(i + di, j + dj, n) for di in (0, 1) for dj in (0, 1)]
    weights = [ws * wt for ws in (1 - s, s) for wt in (1 - t, t)]
    return jnp.stack(cells, axis=-1), jnp.stack(weights, axis=-1)


def _folded(i, j, n: int):
    """Flat index of a cell that may lie one beyond the border."""
    out = (i < 0) | (i >= n)
    i, j = jnp.clip(i, 0, n - 1), jnp.where(out, n - 1 - j, j)
    out = (j < 0) | (j >= n)
    i, j = jnp.where(out, n - 1 - i, i), jnp.clip(j, 0, n - 1)
    return i * n + j


def sampled(values: Numeric, u: Numeric, n: int) -> Float[Array, " q"]:
    """Numbers of a map, shape (n n), interpolated at unit vectors, shape (q, 3)."""
    cells, weights = corners(u, n)
    return jnp.sum(values[cells] * weights, axis=-1)
