"""Springs and dampers between two points."""

from collections.abc import Callable
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.legal import non_negative
from spherejax.foundations.types import OWN, Function, Named, Number, Scalar, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.line import (
    AbstractLineForce,
    Attachment,
    Pull,
    elastic_part,
    is_without_damping,
    line_requirements,
    stores_all,
    two_ends,
)
from spherejax.physics.forces.one_sided import smooth_rise
from spherejax.physics.functions.base import AbstractFunction, Given, as_function, function_requirements
from spherejax.physics.functions.shapes import finite


class SpringDamper(AbstractLineForce):
    """A spring and a damper along the line between two points, or along a fixed direction.

        f = k u + c u_rate + spring(u) + damper(u_rate) + law(length, rate, t),    u = length - free_length

    What is given adds up; f is the tension, positive while it pulls the points together.

    Attributes:
        ends: `"body.point"` of the two points; `"body"` alone is its center of mass.
        stiffness: k [N/m].
        damping: c [N s/m].
        free_length: length at which u = 0 [m]; with 0, the default, functions are of the length itself.
        spring: tension [N] by u [m]; any function of one number.
        damper: tension [N] by u_rate [m/s]; any function of one number.
        law: tension [N] by length [m], rate [m/s] and time [s]; any function of three numbers.
        direction: world axes at the start; then length is the distance along it (it may be negative), and it turns
            with the first body. None: along the line between the points.
        attachment: the geometry in body axes, once the scene is compiled.

    The energy is counted from u = 0. A spring function that does not know its integral, and a law, store no energy:
    their work counts as dissipated.

    Limits: see `Attachment.stretch` for coinciding points. A spring with a free length has no direction there, and its
    force turns round over 1e-12 m.
    """

    ends: tuple[str, str] = eqx.field(static=True)
    stiffness: Number
    damping: Number
    free_length: Number
    spring: AbstractFunction | None
    damper: AbstractFunction | None
    law: Given | None
    direction: Triple | None
    attachment: Attachment | None

    def __init__(
        self,
        ends: Annotated[tuple[str, str], Named.ENDS],
        stiffness: Annotated[Number, Unit("N/m")] = 0.0,
        damping: Annotated[Number, Unit("N s/m")] = 0.0,
        free_length: Annotated[Number, Unit("m")] = 0.0,
        *,
        spring: Annotated[Callable | None, Function("m", "N")] = None,
        damper: Annotated[Callable | None, Function("m/s", "N")] = None,
        law: Annotated[Callable | None, OWN] = None,
        direction: Annotated[Triple, Unit("1")] = None,
    ):
        self.ends = two_ends(ends)
        self.stiffness = stiffness
        self.damping = damping
        self.free_length = free_length
        self.spring = as_function(spring)
        self.damper = as_function(damper)
        self.law = None if law is None else Given(law)
        self.direction = None if direction is None else numbers(direction)
        self.attachment = None

    @property
    def never_adds_energy(self) -> bool:
        """With numbers for damping, and a spring that knows its integral."""
        return self.law is None and stores_all(self.spring, self.damper)

    @property
    def conserves_energy(self) -> bool:
        """Without damping."""
        return self.never_adds_energy and is_without_damping(self.damping)

    def pull(self, length: Scalar, rate: Scalar, t: Scalar) -> Pull:
        """Tension and stored energy."""
        u = length - self.free_length
        value, elastic, energy = elastic_part(self.spring, u)
        linear = self.stiffness * u
        force = linear + self.damping * rate + value
        if self.damper is not None:
            force = force + self.damper(rate)
        if self.law is not None:
            force = force + jnp.asarray(self.law(length, rate, t))
        return Pull(force, linear + elastic, 0.5 * linear * u + energy)

    def requirements(self) -> list[Requirement]:
        """Two bodies, k >= 0, c >= 0, and what the functions require."""
        return [
            *line_requirements(self.ends, self.direction),
            non_negative("stiffness", self.stiffness, "N/m"),
            non_negative("damping", self.damping, "N s/m"),
            finite("free_length", self.free_length),
            *function_requirements("spring", self.spring),
            *function_requirements("damper", self.damper),
        ]


class ShockAbsorber(AbstractLineForce):
    """A spring, and a damper that resists extension and compression differently.

        f = spring(u) + (1 - w) compression(rate) + w extension(rate),    u = length - free_length

    w rises from 0 to 1 while the rate goes from -transition to transition, with continuous slope. f is the tension.

    Attributes:
        ends: `"body.point"` of the two points.
        compression: tension [N] by rate [m/s] while it gets shorter (rate < 0, so the tension is negative).
        extension: tension [N] by rate [m/s] while it gets longer.
        spring: tension [N] by u [m], or None.
        free_length: length at which u = 0 [m]; with 0, the default, `spring` is a function of the length itself.
        transition: rate [m/s] up to which both damper functions count; with 0 they change at once, which is a jump
            unless both vanish at rate 0.
        direction: as in `SpringDamper`.
        attachment: the geometry in body axes, once the scene is compiled.

    A single damper function, as Eq. 43 of Rodrigues da Silva et al. (2022), goes into a `SpringDamper`.
    """

    ends: tuple[str, str] = eqx.field(static=True)
    compression: AbstractFunction
    extension: AbstractFunction
    spring: AbstractFunction | None
    free_length: Number
    transition: Number
    direction: Triple | None
    attachment: Attachment | None

    def __init__(
        self,
        ends: Annotated[tuple[str, str], Named.ENDS],
        compression: Annotated[Callable, Function("m/s", "N")],
        extension: Annotated[Callable, Function("m/s", "N")],
        spring: Annotated[Callable | None, Function("m", "N")] = None,
        free_length: Annotated[Number, Unit("m")] = 0.0,
        transition: Annotated[Number, Unit("m/s")] = 1e-2,
        *,
        direction: Annotated[Triple, Unit("1")] = None,
    ):
        compressing, extending = as_function(compression), as_function(extension)
        if compressing is None or extending is None:
            raise TypeError("a shock absorber needs compression= and extension=; for one function take SpringDamper")
        self.ends = two_ends(ends)
        self.compression = compressing
        self.extension = extending
        self.spring = as_function(spring)
        self.free_length = free_length
        self.transition = transition
        self.direction = None if direction is None else numbers(direction)
        self.attachment = None

    def pull(self, length: Scalar, rate: Scalar, t: Scalar) -> Pull:
        """Tension and stored energy."""
        del t
        value, elastic, energy = elastic_part(self.spring, length - self.free_length)
        w = smooth_rise(rate + self.transition, 2.0 * jnp.asarray(self.transition))
        slow = self.compression(rate)
        return Pull(value + slow + w * (self.extension(rate) - slow), elastic, energy)

    def requirements(self) -> list[Requirement]:
        """Two bodies, transition >= 0, and what the functions require."""
        return [
            *line_requirements(self.ends, self.direction),
            finite("free_length", self.free_length),
            non_negative("transition", self.transition, "m/s"),
            *function_requirements("spring", self.spring),
            *function_requirements("compression", self.compression),
            *function_requirements("extension", self.extension),
        ]
