"""The integral of another function: an angle by its speed, a travel by its velocity.

Where the rate's integral is a formula (constants, lines, polynomials, sines, steps, bumps, tables, and pieces and sums
of these) it is that formula. Of others it is Gauss's quadrature over equal panels from `origin` to `until`:

    f(x) = start + I_1 + ... + I_k + (integral from the panel's begin to x)

Each I is a sum over ten points, and so is the part of a panel up to x. It is smooth within a panel, and its derivatives
by the rate's numbers are those of the sums. Whether the panels are short enough is checked by halving them. Panels are
not chosen adaptively: that would be structure which follows from numbers, and these may be traced. Nor is the integral
a state of the run: what drivers prescribe is a function of time alone.
"""

from collections.abc import Callable
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, concretely
from spherejax.foundations.types import Function, Number, Scalar, Unit
from spherejax.physics.functions.base import AbstractFunction, function_requirements
from spherejax.physics.functions.pieces import Piecewise, Sum
from spherejax.physics.functions.shapes import finite, function_or_constant

_POINTS, _WEIGHTS = np.polynomial.legendre.leggauss(10)
POINTS, WEIGHTS = (_POINTS + 1.0) / 2.0, _WEIGHTS / 2.0
"""Of Gauss's quadrature on [0, 1]: exact for polynomials up to the 19th degree."""

RESOLVED = 1e-11
"""By how much an integral may change when its panels are halved, as a share of the integral of the rate's magnitude:
the error of the panels, for halved ones have hardly any. Below it comes the rounding of rates of many operations."""

BEYOND = 1e-6
"""How far x may lie outside of origin and until, in panels: rounding of the last sample time."""


class Integral(AbstractFunction):
    """The integral of another function.

        f(x) = start + integral of rate from origin to x

    An angle by its speed, of a driver or as a controller's reference:

        sj.RotationDriver(("ground", "crank"), axis, sj.functions.Integral(sj.functions.Table([0.0, 0.5], [0.0, 30.0]),
        start=0.2))

    Attributes:
        rate: the function that is integrated, or a number for a constant rate.
        start: f(origin).
        origin: where f is start.
        until: up to where f is needed; must be given where the rate's integral is no formula, as of a Python function.
        panels: number of panels of the quadrature from origin to until, or of each piece of a `Piecewise`; not used
            where the integral is a formula.

    Limits: steps of the integration end where the rate says that it begins, ends or turns. Where the integral is no
    formula the rate must be smooth from origin to until, or a `Piecewise` of smooth functions, and each panel must
    resolve it: this is checked. Outside of origin and until such an integral is NaN; drivers refuse sample times there.
    """

    rate: AbstractFunction
    start: Number
    origin: Number
    until: Number | None
    panels: int = eqx.field(static=True)

    def __init__(
        self,
        rate: Annotated[
            Number | Callable,
            Unit("({of_value})/({of_argument})"),
            Function("{of_argument}", "({of_value})/({of_argument})"),
        ],
        start: Annotated[Number, Unit("{of_value}")] = 0.0,
        origin: Annotated[Number, Unit("{of_argument}")] = 0.0,
        until: Annotated[Number | None, Unit("{of_argument}")] = None,
        panels: int = 16,
    ):
        self.rate = function_or_constant(rate)
        self.start = start
        self.origin = origin
        self.until = until
        self.panels = panels

    def __call__(self, x: Number) -> Scalar:
        """start + F(x) - F(origin)."""
        whole = _integrable(self.rate, self.origin, self._end, self.panels)
        return jnp.asarray(self.start + (whole.primitive(x) - whole.primitive(self.origin)))

    def derivative(self, x: Number) -> Scalar:
        """rate(x)."""
        return self.rate(x)

    def second_derivative(self, x: Number) -> Scalar:
        """The rate's derivative."""
        return self.rate.derivative(x)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar | None:
        """As the rate's."""
        return self.rate.distance_to_breakpoint(x, is_forward)

    @property
    def is_unknown(self) -> bool:
        """Whether the rate is."""
        return self.rate.is_unknown

    @property
    def may_jump(self) -> bool:
        """Whether the rate may: the integral has a kink there."""
        return self.rate.may_jump

    @property
    def domain(self) -> tuple[Number, Number] | None:
        """From origin to until, where the integral is no formula."""
        return None if self.rate.knows_primitive else (self.origin, self._end)

    @property
    def _end(self) -> Number:
        return self.origin if self.until is None else self.until

    def requirements(self) -> list[Requirement]:
        """Those of the rate, and panels that are short enough."""
        rows = [
            *function_requirements("rate", self.rate),
            finite("start", self.start),
            finite("origin", self.origin),
        ]
        if self.rate.knows_primitive:
            return rows
        remedy = "Give the end of the motion: sj.functions.Integral(rate, start, until=2.0)."
        if self.until is None:
            return [*rows, Requirement("until", None, False, "be there, for the rate's integral is no formula", remedy)]
        if self.panels < 1:
            return [*rows, Requirement("panels", self.panels, False, "be 1 or more", "Leave it out for 16.")]
        is_ahead = self.until > self.origin
        rows.append(Requirement("until", self.until, is_ahead, "be above origin", "Give the end of the motion."))
        stray = concretely(_largest_stray, self.rate, self.origin, self.until, self.panels)
        expected = "be enough for the rate: its integral changes when they are halved"
        remedy = (
            f"Give more, as panels={4 * self.panels}. Where the rate jumps or has a kink, say where: "
            "sj.functions.Piecewise([t], [f, g]), or sj.functions.Table."
        )
        return [*rows, Requirement("panels", self.panels, stray <= RESOLVED, expected, remedy)]


class _Quadrature(AbstractFunction):
    """A function between two places, with a primitive by Gauss's quadrature that is zero at the first.

    Attributes:
        function: the function.
        low, high: the places.
        panels: between them.
    """

    function: AbstractFunction
    low: Number
    high: Number
    panels: int = eqx.field(static=True)

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        return self.function(x)

    @property
    def knows_primitive(self) -> bool:
        """True."""
        return True

    def primitive(self, x: Number) -> Scalar:
        """The integral from low to x; NaN outside of low and high."""
        length = (jnp.asarray(self.high, jnp.float64) - self.low) / self.panels
        begins = self.low + length * np.arange(self.panels)
        before = jnp.asarray(np.tri(self.panels, k=-1)) @ self._by_panels(self.panels)[0]
        # Chosen by comparisons, not by a computed index, which scalar programs do not have.
        begun = jnp.concatenate([jnp.ones(1, bool), x >= begins[1:]])
        is_here = begun & jnp.concatenate([~begun[1:], jnp.ones(1, bool)])
        begin, before = (jnp.sum(jnp.where(is_here, column, 0.0)) for column in (begins, before))
        tolerance = BEYOND * jnp.abs(length)
        is_known = (x >= self.low - tolerance) & (x <= self.high + tolerance)
        # The rate sees places within alone: it may be undefined elsewhere.
        part = jnp.where(is_known, x, begin) - begin
        within = part * (self._values(begin + part * POINTS) @ WEIGHTS)
        return before + within + jnp.where(is_known, 0.0, jnp.nan)

    def _values(self, places: Float[Array, " n"]) -> Float[Array, " n"]:
        return jax.vmap(lambda x: jnp.asarray(self.function(x), jnp.float64))(places)

    def stray(self) -> Float[Array, ""]:
        """How much the integral changes with halved panels, as a share of the integral of the magnitude."""
        coarse, fine = (self._by_panels(n) for n in (self.panels, 2 * self.panels))
        halves = jnp.sum(fine[0].reshape(-1, 2), axis=1)
        return jnp.sum(jnp.abs(coarse[0] - halves)) / jnp.maximum(jnp.sum(fine[1]), 1e-300)

    def _by_panels(self, n: int) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
        """Integrals of the function and of its magnitude over each of n panels."""
        length = (jnp.asarray(self.high, jnp.float64) - self.low) / n
        places = self.low + length * (np.arange(n)[:, None] + POINTS)
        values = self._values(places.ravel()).reshape(n, -1)
        return length * (values @ WEIGHTS), jnp.abs(length) * (jnp.abs(values) @ WEIGHTS)


def _integrable(function: AbstractFunction, low: Number, high: Number, panels: int) -> AbstractFunction:
    """The function with a primitive: its own, or by quadrature where it has none, piece by piece of a `Piecewise`."""
    if function.knows_primitive:
        return function
    if isinstance(function, Sum):
        return Sum(*(_integrable(term, low, high, panels) for term in function.terms))
    if isinstance(function, Piecewise):
        breaks = [function.breaks[k] for k in range(len(function.pieces) - 1)]
        ends = [jnp.minimum(low, breaks[0]), *breaks, jnp.maximum(high, breaks[-1])]
        pieces = zip(function.pieces, ends[:-1], ends[1:], strict=True)
        return Piecewise(function.breaks, [_integrable(piece, a, b, panels) for piece, a, b in pieces])
    return _Quadrature(function, low, high, panels)


def _largest_stray(rate: AbstractFunction, low: Number, high: Number, panels: int) -> Float[Array, ""]:
    """The largest of all parts that are integrated by quadrature."""
    is_part = lambda part: isinstance(part, _Quadrature)  # noqa: E731
    whole = _integrable(rate, low, high, panels)
    parts = [part for part in jax.tree.leaves(whole, is_leaf=is_part) if is_part(part)]
    return jnp.max(jnp.stack([part.stray() for part in parts]))
