"""Functions by formula: constants, lines, polynomials, sines, steps and bumps."""

from collections.abc import Callable
from typing import Annotated

import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import above, numeric, positive
from spherejax.foundations.numerics import horner
from spherejax.foundations.types import COEFFICIENTS, Number, Numeric, Scalar, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.functions.base import AbstractFunction, as_function, distance_to_next


class _KnowsPrimitive(AbstractFunction):
    """A function whose integral is a formula."""

    @property
    def knows_primitive(self) -> bool:
        """True."""
        return True

    @property
    def may_jump(self) -> bool:
        """False."""
        return False


class Constant(_KnowsPrimitive):
    """f(x) = value.

    Attributes:
        value: the value.
    """

    value: Annotated[Number, Unit("{of_value}")]

    def __call__(self, x: Number) -> Scalar:
        """The value."""
        del x
        return jnp.asarray(self.value)

    def primitive(self, x: Number) -> Scalar:
        """F(x) = value x."""
        return jnp.asarray(self.value * x)

    def requirements(self) -> list[Requirement]:
        """A finite value."""
        return [finite("value", self.value)]


def function_or_constant(value: Number | Callable) -> AbstractFunction:
    """A callable as a function, see `as_function`; a number as a `Constant`."""
    function = as_function(value if callable(value) else Constant(value))
    assert function is not None
    return function


class Linear(_KnowsPrimitive):
    """f(x) = offset + slope x.

    Attributes:
        slope: df/dx.
        offset: f(0).
    """

    slope: Annotated[Number, Unit("({of_value})/({of_argument})")]
    offset: Annotated[Number, Unit("{of_value}")] = 0.0

    def __call__(self, x: Number) -> Scalar:
        """f(x) = offset + slope x."""
        return jnp.asarray(self.offset + self.slope * x)

    def primitive(self, x: Number) -> Scalar:
        """F(x) = offset x + slope x^2/2."""
        return jnp.asarray(x * (self.offset + 0.5 * self.slope * x))

    def requirements(self) -> list[Requirement]:
        """Finite numbers."""
        return [finite("slope", self.slope), finite("offset", self.offset)]


class PowerTail(AbstractFunction):
    """f(x) = value up to x = start, and value (x/start)^power from there.

    The restitution of metals by the speed of the impact is such a function: constant up to yield, and from there it
    falls with power = -1/4 (Johnson, Contact Mechanics, 1985, section 11.5).

    Attributes:
        value: f up to start.
        start: where the tail begins, above zero.
        power: the exponent [-].

    Limits: continuous, with a kink at start, where the slope is 0.
    """

    value: Annotated[Number, Unit("{of_value}")]
    start: Annotated[Number, Unit("{of_argument}")]
    power: Annotated[Number, Unit("1")] = -0.25

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        return jnp.asarray(self.value * jnp.maximum(x / self.start, 1.0) ** self.power)

    def requirements(self) -> list[Requirement]:
        """Finite numbers, a positive start."""
        return [finite("value", self.value), positive("start", self.start, "unit of x"), finite("power", self.power)]


class Polynomial(_KnowsPrimitive):
    """f(x) = c_0 + c_1 (x - x_0) + c_2 (x - x_0)^2 + ...

    Attributes:
        coefficients: c_0, c_1, ..., lowest power first, shape (n,), n >= 1.
        center: x_0.
    """

    coefficients: Numeric
    center: Number

    def __init__(
        self, coefficients: Annotated[Numeric, COEFFICIENTS], center: Annotated[Number, Unit("{of_argument}")] = 0.0
    ):
        self.coefficients = numbers(coefficients)
        self.center = center

    def __call__(self, x: Number) -> Scalar:
        """f(x), by Horner's rule."""
        c = self.coefficients
        return jnp.asarray(horner([c[k] for k in range(len(c))], x - self.center))

    def primitive(self, x: Number) -> Scalar:
        """F(x) = sum of c_k (x - x_0)^(k + 1) / (k + 1)."""
        c, u = self.coefficients, x - self.center
        return jnp.asarray(u * horner([c[k] / (k + 1) for k in range(len(c))], u))

    def requirements(self) -> list[Requirement]:
        """At least one coefficient, all finite."""
        c = numeric(self.coefficients)
        if c.ndim != 1 or c.size == 0:
            remedy = "Give the lowest power first, e.g. [0.0, 1e4] for 1e4 x."
            return [Requirement("coefficients", self.coefficients, False, "be a list of one or more numbers", remedy)]
        return [finite("coefficients", self.coefficients), finite("center", self.center)]


class Sine(_KnowsPrimitive):
    """f(x) = offset + amplitude sin(2 pi frequency x + phase).

    Attributes:
        amplitude: height of the crests over the mean.
        frequency: cycles for each unit of x: [Hz] for a function of time, [1/m] for a road.
        phase: at x = 0 [rad].
        offset: mean.
    """

    amplitude: Annotated[Number, Unit("{of_value}")]
    frequency: Annotated[Number, Unit("1/({of_argument})")]
    phase: Annotated[Number, Unit("rad")] = 0.0
    offset: Annotated[Number, Unit("{of_value}")] = 0.0

    def __call__(self, x: Number) -> Scalar:
        """f(x) = offset + amplitude sin(2 pi frequency x + phase)."""
        return self.offset + self.amplitude * jnp.sin(2 * np.pi * self.frequency * x + self.phase)

    def primitive(self, x: Number) -> Scalar:
        """F(x) = offset x - amplitude cos(2 pi frequency x + phase) / (2 pi frequency)."""
        rate = 2 * np.pi * self.frequency
        return self.offset * x - self.amplitude / rate * jnp.cos(rate * x + self.phase)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar:
        """Half a cycle, from anywhere."""
        return 0.5 / jnp.maximum(jnp.abs(self.frequency), 1e-300)

    def requirements(self) -> list[Requirement]:
        """A positive frequency, the others finite."""
        return [
            positive("frequency", self.frequency, "cycles for each unit of x"),
            finite("amplitude", self.amplitude),
            finite("phase", self.phase),
            finite("offset", self.offset),
        ]


class Step(_KnowsPrimitive):
    """f(x) = before for x < at, else after.

    A jump costs an integrator many small steps; `SmoothStep` is cheaper to pass.

    Attributes:
        at: where it jumps.
        before: value below.
        after: value from there on.

    Limits: the derivative by x is 0, at the jump as well; the derivative by `at` is 0, which is right only for a
    motion that does not meet the jump.
    """

    at: Annotated[Number, Unit("{of_argument}")]
    before: Annotated[Number, Unit("{of_value}")] = 0.0
    after: Annotated[Number, Unit("{of_value}")] = 1.0

    def __call__(self, x: Number) -> Scalar:
        """before or after."""
        return jnp.where(x < self.at, self.before, self.after)

    def primitive(self, x: Number) -> Scalar:
        """F(x) = before x + (after - before) max(0, x - at)."""
        past = jnp.where(x < self.at, 0.0, x - self.at)
        return self.before * x + (self.after - self.before) * past

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar:
        """To the step."""
        return distance_to_next([self.at], x, is_forward)

    @property
    def may_jump(self) -> bool:
        """True."""
        return True

    def requirements(self) -> list[Requirement]:
        """Finite numbers."""
        return [finite("at", self.at), finite("before", self.before), finite("after", self.after)]


class SmoothStep(_KnowsPrimitive):
    """From one value to another with continuous first and second derivative.

        f(x) = before + (after - before) u^3 (10 - 15 u + 6 u^2),    u = (x - start)/(end - start) in [0, 1]

    Attributes:
        start: where it begins to change.
        end: where it has changed, above `start`.
        before: value up to `start`.
        after: value from `end` on.

    Limits: constant outside; at `start` and `end` the first two derivatives are 0.
    """

    start: Annotated[Number, Unit("{of_argument}")]
    end: Annotated[Number, Unit("{of_argument}")]
    before: Annotated[Number, Unit("{of_value}")] = 0.0
    after: Annotated[Number, Unit("{of_value}")] = 1.0

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        u = self._fraction(x)
        return self.before + (self.after - self.before) * (u * u * u * (10.0 + u * (6.0 * u - 15.0)))

    def primitive(self, x: Number) -> Scalar:
        """F(x) = before x + (after - before) ((end - start) u^4 (5/2 - 3 u + u^2) + max(0, x - end))."""
        u = self._fraction(x)
        inside = (self.end - self.start) * (u * u * u * u * (2.5 + u * (u - 3.0)))
        past = jnp.where(x < self.end, 0.0, x - self.end)
        return self.before * x + (self.after - self.before) * (inside + past)

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar:
        """To where it begins or ends to change."""
        return distance_to_next([self.start, self.end], x, is_forward)

    def requirements(self) -> list[Requirement]:
        """Start before end, all finite."""
        return [
            finite("start", self.start),
            above("end", self.end, "start", self.start),
            finite("before", self.before),
            finite("after", self.after),
        ]

    def _fraction(self, x: Number) -> Scalar:
        return _fraction(x, self.start, self.end - self.start)


class Bump(_KnowsPrimitive):
    """One wave of a cosine, from 0 up and back to 0, with a continuous slope.

        f(x) = height/2 (1 - cos(2 pi u)),    u = (x - start)/length in [0, 1]

    Attributes:
        height: of the crest, in the middle; negative for a hollow.
        start: where it begins.
        length: how long it is.

    Limits: 0 outside with slope 0; the second derivative jumps at both ends.

    Source: Rodrigues da Silva et al. (2022), Eq. 44: `Bump(height=0.2, start=15.0, length=5.0)`.
    """

    height: Annotated[Number, Unit("{of_value}")]
    start: Annotated[Number, Unit("{of_argument}")]
    length: Annotated[Number, Unit("{of_argument}")]

    def __call__(self, x: Number) -> Scalar:
        """f(x)."""
        u = _fraction(x, self.start, self.length)
        return 0.5 * self.height * (1.0 - jnp.cos(2 * np.pi * u))

    def primitive(self, x: Number) -> Scalar:
        """F(x) = height length/2 (u - sin(2 pi u)/(2 pi))."""
        u = _fraction(x, self.start, self.length)
        return 0.5 * self.height * self.length * (u - jnp.sin(2 * np.pi * u) / (2 * np.pi))

    def distance_to_breakpoint(self, x: Number, is_forward: Number) -> Scalar:
        """To the next of its start, its crest and its end."""
        return distance_to_next([self.start, self.start + self.length / 2, self.start + self.length], x, is_forward)

    def requirements(self) -> list[Requirement]:
        """A positive length, the others finite."""
        return [
            positive("length", self.length, "unit of x"),
            finite("height", self.height),
            finite("start", self.start),
        ]


def _fraction(x: Number, start: Number, length: Number) -> Scalar:
    """(x - start)/length, 0 below and 1 above, with a derivative of 0 there."""
    u = (x - start) / length
    return jnp.where(u > 0, jnp.where(u < 1, u, 1.0), 0.0)


def finite(field: str, value) -> Requirement:
    """`value` is finite."""
    return Requirement(field, value, abs(numeric(value)) < np.inf, "be finite", "Check the units and the source.")
