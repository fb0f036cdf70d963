"""Functions by a table of points: straight lines or smooth cubics between them."""

import abc
from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import numeric
from spherejax.foundations.types import Listed, Number, Numeric, Scalar, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.functions.base import AbstractFunction, distance_to_next


class _AbstractTable(AbstractFunction):
    """Cubics between points."""

    x: Numeric
    y: Numeric

    def __init__(self, x, y):
        self.x, self.y = numbers(x), numbers(y)

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        return _cubic_at(self._cubics(), x)

    def primitive(self, x: Number) -> Scalar:
        """F(x), zero at the first point."""
        return _integral_at(self._cubics(), x)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar:
        """To the next point."""
        return distance_to_next(self.x, x, is_forward)

    def requirements(self) -> list[Requirement]:
        """Two points or more, in order."""
        return _requirements(self.x, self.y)

    @property
    def knows_primitive(self) -> bool:
        """True."""
        return True

    @property
    def may_jump(self) -> bool:
        """False: its slope jumps at points alone."""
        return False

    @abc.abstractmethod
    def _cubics(self) -> "_Cubics":
        """The pieces."""


class Table(_AbstractTable):
    """Straight lines between given points, continued straight beyond the first and the last.

    Attributes:
        x: abscissas, increasing, shape (n,), n >= 2.
        y: ordinates, shape (n,).

    Limits: at a point the slope is that of the line that begins there. An integrator of high order takes small steps
    over such kinks; `SmoothTable` has none.
    """

    def __init__(self, x: Annotated[Listed, Unit("{of_argument}")], y: Annotated[Listed, Unit("{of_value}")]):
        super().__init__(x, y)

    def _cubics(self) -> "_Cubics":
        x, y = jnp.asarray(self.x), jnp.asarray(self.y)
        slopes = (y[1:] - y[:-1]) / (x[1:] - x[:-1])
        zero = jnp.zeros_like(slopes)
        return _Cubics(x[1:-1], x[:-1], y[:-1], slopes, zero, zero)


class SmoothTable(_AbstractTable):
    """Cubics through given points with a continuous slope, rising and falling only where the points do.

    At the first and the last point the slope is that of the straight line to the next one, and beyond it goes on with
    this slope. It does not overshoot.

    Attributes:
        x: abscissas, increasing, shape (n,), n >= 2.
        y: ordinates, shape (n,).

    Limits: the second derivative jumps at the points. Two points give a straight line.

    Source: Fritsch and Butland (1984), SIAM J. Sci. Stat. Comput. 5:300-304, weighted harmonic mean slopes; those at
    the ends, chosen for what follows beyond them, keep to their condition for monotony.
    """

    def __init__(self, x: Annotated[Listed, Unit("{of_argument}")], y: Annotated[Listed, Unit("{of_value}")]):
        super().__init__(x, y)

    def _cubics(self) -> "_Cubics":
        x, y = jnp.asarray(self.x), jnp.asarray(self.y)
        h = x[1:] - x[:-1]
        d = (y[1:] - y[:-1]) / h
        m = jnp.concatenate([d[:1], _interior_slopes(h, d), d[-1:]])
        m0, m1 = m[:-1], m[1:]
        quadratic, cubic = (3.0 * d - 2.0 * m0 - m1) / h, (m0 + m1 - 2.0 * d) / (h * h)
        zero = jnp.zeros(1)
        return _Cubics(
            x,
            jnp.concatenate([x[:1], x]),
            jnp.concatenate([y[:1], y]),
            jnp.concatenate([m[:1], m]),
            jnp.concatenate([zero, quadratic, zero]),
            jnp.concatenate([zero, cubic, zero]),
        )


class _Cubics(NamedTuple):
    """y + u (c1 + u (c2 + u c3)) with u = x - start, piece by piece; the first begins at minus infinity.

    Attributes:
        breaks: where the second and the later pieces begin, shape (n - 1,).
        start: where u = 0, shape (n,).
        y: value there.
        c1: slope there.
        c2: quadratic coefficient.
        c3: cubic coefficient.
    """

    breaks: Float[Array, " m"]
    start: Float[Array, " n"]
    y: Float[Array, " n"]
    c1: Float[Array, " n"]
    c2: Float[Array, " n"]
    c3: Float[Array, " n"]


def _cubic_at(cubics: _Cubics, x: Number) -> Scalar:
    here = _is_here(cubics, x)
    start, y, c1, c2, c3 = (_chosen(here, column) for column in cubics[1:])
    u = x - start
    return y + u * (c1 + u * (c2 + u * c3))


def _integral_at(cubics: _Cubics, x: Number) -> Scalar:
    """Integral from the first piece's start."""
    h = cubics.breaks - cubics.start[:-1]
    whole = _integral_of(h, *(column[:-1] for column in cubics[2:]))
    before = jnp.concatenate([jnp.zeros(1), jnp.asarray(np.tri(len(h))) @ whole])
    here = _is_here(cubics, x)
    start, y, c1, c2, c3 = (_chosen(here, column) for column in cubics[1:])
    return _chosen(here, before) + _integral_of(x - start, y, c1, c2, c3)


def _integral_of(u, y, c1, c2, c3):
    return u * (y + u * (c1 / 2.0 + u * (c2 / 3.0 + u * c3 / 4.0)))


def _is_here(cubics: _Cubics, x: Number) -> Bool[Array, " n"]:
    """Which piece x is in: comparisons instead of a computed index, which scalar programs do not have."""
    begun = jnp.concatenate([jnp.ones(1, bool), x >= cubics.breaks])
    return begun & jnp.concatenate([~begun[1:], jnp.ones(1, bool)])


def _chosen(here: Bool[Array, " n"], column: Float[Array, " n"]) -> Scalar:
    return jnp.sum(jnp.where(here, column, 0.0))


def _interior_slopes(h, d):
    """Slopes at the points between two segments of lengths h and slopes d: zero at a crest and beside a flat one."""
    h0, h1, d0, d1 = h[:-1], h[1:], d[:-1], d[1:]
    monotone = d0 * d1 > 0
    w0, w1 = 2.0 * h1 + h0, h1 + 2.0 * h0
    harmonic = (w0 + w1) / (w0 / jnp.where(monotone, d0, 1.0) + w1 / jnp.where(monotone, d1, 1.0))
    return jnp.where(monotone, harmonic, 0.0)


def _requirements(abscissae, ordinates) -> list[Requirement]:
    x, y = numeric(abscissae), numeric(ordinates)
    if x.ndim != 1 or x.shape != y.shape or x.shape[0] < 2:
        expected = "be a list of two or more numbers, as many as y"
        return [Requirement("x", abscissae, False, expected, "Give one ordinate y for each abscissa x.")]
    increasing = (x[1:] > x[:-1]).all() & (abs(x) < np.inf).all()
    return [
        Requirement("x", abscissae, increasing, "increase and be finite", "Sort the points and leave out doubles."),
        Requirement("y", ordinates, abs(y) < np.inf, "be finite", "Check the table."),
    ]
