"""Pressure and deflection along the axis of a lined bearing: one parabola, or a polynomial through several unknowns.

With s = 2 z/L, which is 1 at the ends, the deflection w(s) is even and w(1) = 0. Galerkin's method, with the weights of
its own functions, keeps the balance of energy whatever their number:

* one unknown at each point round the bearing, w (1 - s**2), with exact integrals of the gap's cube (`_Parabola`);
* n >= 2 of them, w(s) = (1 - s**2) (a polynomial of degree n - 1 in s**2) through the values w_k at the n nodes s_k > 0
  of Gauss and Lobatto's rule of 2 n + 2 points (`_Nodes`). The rule is exact up to the degree 4 n + 1, and w**2 has
  4 n: so the mass matrix is diagonal without any lumping, its entries the weights m_k, and each node has an equation
  of its own, with the flow along the axis

      leaving_k = (4/L**2) (1/m_k) sum_q m_q D_qk h_q**3 sum_l D_ql w_l,      D_qk = dw/ds at s_q by w_k

  where q goes over the nodes and the end, at which w = 0. sum_k m_k w_k leaving_k is a sum of squares, so this flow
  dissipates, whatever the gap. Where the gap is nearly closed at the ends and wide in the middle, pressure is flat with
  a steep end; nodes crowd there.

Source: Abramowitz and Stegun (1964), 25.4.32, for the rule; collocation at its nodes as in spectral elements, Patera
(1984), J. Comput. Phys. 54:468-488.
"""

import abc
from functools import cache

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.types import Number

_AXIAL = (4.0 / 3.0, 8.0 / 5.0, 32.0 / 35.0, 64.0 / 315.0)
"""Of int 4 s**2 (h_0 + w (1 - s**2))**3 ds from 0 to 1, in h_0**3, h_0**2 w, h_0 w**2, w**3."""

_ROUND = (8.0 / 15.0, 48.0 / 35.0, 128.0 / 105.0, 256.0 / 693.0)
"""Of int (1 - s**2)**2 (h_0 + w (1 - s**2))**3 ds, likewise."""

_FLOW = (2.0 / 3.0, 8.0 / 5.0, 48.0 / 35.0, 128.0 / 315.0)
"""Of int (1 - s**2) (h_0 + w (1 - s**2))**3 ds, likewise."""

_SQUARE, _MEAN = 8.0 / 15.0, 2.0 / 3.0
"""Of int (1 - s**2)**2 ds and int (1 - s**2) ds."""


def between(values: Array) -> Array:
    """Between each point and the next one."""
    return 0.5 * (values + jnp.roll(values, -1, -1))


def _conductance(factors: tuple[float, ...], gap: Array, deflection: Array) -> Array:
    """A cubic form of the gap and the deflection [m^3]."""
    a, b, c, d = factors
    return ((a * gap + b * deflection) * gap + c * deflection**2) * gap + d * deflection**3


class AbstractProfile(abc.ABC):
    """What integrals along the axis are in the unknowns at each point.

    Attributes:
        square: of the profile of one unknown, its mass as a share of the length.
        mean: of this profile.
        empty: thickness of the oil that is missing where w < 0, over -w. The equation there is
            square dw/dt = mean V.u, and the missing thickness m has dm/dt = -V.u.
    """

    square: float
    mean: float
    empty: float

    @abc.abstractmethod
    def arranged(self, memory: Float[Array, " unknowns"]) -> Array:
        """The unknowns with the points as the last axis."""

    @abc.abstractmethod
    def along(self, values: Array) -> Float[Array, " points"]:
        """Sum along the axis, each unknown by its weight."""

    @abc.abstractmethod
    def oil(self, values: Array) -> Float[Array, " points"]:
        """Mean of a thickness along the axis, over `empty`; oil up to the ends counts."""

    @abc.abstractmethod
    def inner(self, first: Array, second: Array) -> Array:
        """Sum of products along the axis and round the bearing."""

    @abc.abstractmethod
    def middle(self, memory: Array, deflections: Array) -> Float[Array, " points"]:
        """Deflection in the middle of the length [m]."""

    @abc.abstractmethod
    def round_conductance(self, rigid: Float[Array, " points"], deflections: Array) -> Array:
        """Of the flow from each point to the next one, as it enters the equation [m^3]."""

    @abc.abstractmethod
    def flow_conductance(self, rigid: Float[Array, " points"], deflections: Array) -> Array:
        """Of the volume that flows there [m^3]."""

    @abc.abstractmethod
    def leaving(self, length: Number, rigid: Float[Array, " points"], deflections: Array, missing: Array) -> Array:
        """What flows along the axis out of each unknown, as it enters the equation [m^2].

        An empty unknown sinks until what its neighbors' pressure drives to it makes up for what it lacks.

        Args:
            length: of the bearing [m].
            rigid: gap of rigid circles [m].
            deflections: of the liner where it is pressed [m].
            missing: the same and, below zero, what an empty unknown lacks [m]; the same array where nothing does.
        """

    @abc.abstractmethod
    def sheared(self, share: Array, rigid: Float[Array, " points"], deflections: Array) -> Array:
        """A quantity, over the gap, as a mean along the axis [1/m]."""


class _Parabola(AbstractProfile):
    """w (1 - s**2), w in the middle of the length."""

    square, mean, empty = _SQUARE, _MEAN, _SQUARE / _MEAN

    def arranged(self, memory):
        return memory

    def along(self, values):
        return values

    def oil(self, values):
        return values

    def inner(self, first, second):
        return first @ second

    def middle(self, memory, deflections):
        return memory

    def round_conductance(self, rigid, deflections):
        return between(_conductance(_ROUND, rigid, deflections))

    def flow_conductance(self, rigid, deflections):
        return between(_conductance(_FLOW, rigid, deflections))

    def leaving(self, length, rigid, deflections, missing):
        return 4.0 / length**2 * _conductance(_AXIAL, rigid, deflections) * missing

    def sheared(self, share, rigid, deflections):
        return share / (rigid + _MEAN * deflections)


class _Nodes(AbstractProfile):
    """A polynomial through n deflections, node by node from the middle; from point to point the gap halfway is the mean
    of both, and its cube is taken there. The mean of both cubes has two or three times the error by points.

    Attributes:
        places: s of the nodes.
        weights: m, of the nodes.
        end: weight of the end, where there is no deflection.
        slopes: D, dw/ds at the nodes and at the end.
        in_middle: w(0) by the deflections.
    """

    square = mean = empty = 1.0

    def __init__(self, n: int):
        rule = np.polynomial.legendre.Legendre.basis(2 * n + 1)
        scale = 2.0 / ((2 * n + 1) * (2 * n + 2))
        extrema = np.sort(rule.deriv().roots().real)
        self.places = s = extrema[n:]
        self.weights = scale / rule(s) ** 2
        self.end = scale
        powers, all_places = np.arange(n), np.append(s, 1.0)[:, None]
        functions = np.linalg.inv((1.0 - s[:, None] ** 2) * s[:, None] ** (2 * powers))
        rising = 2 * powers * all_places ** np.maximum(2 * powers - 1, 0)
        self.slopes = (rising - (2 * powers + 2) * all_places ** (2 * powers + 1)) @ functions
        self.in_middle = functions[0]

    def arranged(self, memory):
        return memory.reshape(self.weights.size, -1)

    def along(self, values):
        return self.weights @ values

    def oil(self, values):
        return self.along(values) + self.end * values[-1]

    def inner(self, first, second):
        return jnp.sum(self.along(first * second))

    def middle(self, memory, deflections):
        return self.in_middle @ deflections

    def round_conductance(self, rigid, deflections):
        return between(rigid + deflections) ** 3

    def flow_conductance(self, rigid, deflections):
        return self.round_conductance(rigid, deflections)

    def leaving(self, length, rigid, deflections, missing):
        by_cube = np.append(self.weights, self.end)[:, None] * self.slopes
        cubes = jnp.concatenate([rigid + deflections, rigid[None]]) ** 3
        leaving = by_cube.T @ (cubes * (self.slopes @ deflections))
        if missing is not deflections:
            leaving = leaving + (by_cube * self.slopes).T @ cubes * jnp.minimum(missing, 0.0)
        return 4.0 / length**2 / self.weights[:, None] * leaving

    def sheared(self, share, rigid, deflections):
        at_end = share[-1] if jnp.ndim(share) > 1 else share
        return self.along(share / (rigid + deflections)) + self.end * at_end / rigid


@cache
def profile_of(unknowns: int) -> AbstractProfile:
    """With so many unknowns along half of the length."""
    return _Parabola() if unknowns == 1 else _Nodes(unknowns)
