"""Drivers: an angle, a translation or a position prescribed as a function of time.

A driver stands beside the joint that guides the motion: a motor is a `Revolute` and a `RotationDriver` between the same
bodies. The equations are scaled so that -lambda is the driving torque [N m] or force [N], which
`run.driving_effort(name)` reports. At the start the mechanism is assembled to the driver's position and velocity.

The function of time is one of `spherejax.physics.functions` (`Linear(slope, offset)`, `Sine(...)`, `SmoothStep(...)`),
the `Integral` of a speed by time, or any callable in jnp. Numbers that are to be swept or differentiated are fields of
an `equinox.Module` with `__call__`; a plain function is structure: define it once, since each new function object is
compiled anew.

What is prescribed must not jump; `spherejax.motion.start.jumps` looks before a run. Its rate may jump where the
function says by `distance_to_breakpoint` that it turns, as `Table` and `Piecewise` do: with a correction of each step
(the default drift control) that is an impact of the driver.
"""

from collections.abc import Callable
from typing import Annotated

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.forms import two_names
from spherejax.foundations.types import OWN, Function, Named, Number, Numeric, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.functions.base import AbstractFunction
from spherejax.physics.joints.body_axes import (
    cross,
    direction_requirement,
    perpendicular,
    places_of,
    point_requirements,
    split_point,
    turned,
    unit,
    world_at_start,
)
from spherejax.physics.joints.joint import (
    AbstractJoint,
    AbstractPairJoint,
    AbstractPlacedAtPoints,
    AbstractPlacedJoint,
)
from spherejax.physics.joints.prescribed import prescribed, prescribed_by, time_requirements
from spherejax.physics.joints.rows import differentiated_rows
from spherejax.physics.kinematics import point_motion


class RotationDriver(AbstractPairJoint):
    """The angle by which the second body has turned against the first is prescribed: one constraint equation.

        Phi = p . b_perpendicular(t) = sin(phi - angle(t)),    b_perpendicular = -sin(angle) u + cos(angle) v

    u and v are fixed in the first body, across the axis; p in the second body, on u where angle = 0. Only sine and
    cosine of the angle occur: it may run through any number of turns.

    Attributes:
        bodies: names of the two bodies, which a revolute or cylindrical joint with the same axis guides.
        axis: world axes at the start, any length, shape (3,); the second body turns about it by the right hand.
        angle: a function of time t [s] in jnp, in rad; 0 is the orientation of the described start. Smooth to the
            second derivative.
        rate: given instead of angle, a motor's speed by time: a number [rad/s], or a function of time. The angle is its
            `Integral`; of a Python function give angle=sj.functions.Integral(rate, start, until=...).
        start: with rate, the angle at t = 0 [rad].
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    axis: Triple
    angle: AbstractFunction

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        axis: Annotated[Triple, Unit("1")],
        angle: Annotated[Callable | None, Function("s", "rad")] = None,
        rate: Annotated[Number | Callable | None, Unit("rad/s"), Function("s", "rad/s")] = None,
        start: Annotated[Number, Unit("rad")] = 0.0,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.axis = numbers(axis)
        self.angle = prescribed_by(angle, "angle", rate, start)

    def requirements(self) -> list[Requirement]:
        """A direction, and a function that gives one number."""
        return [direction_requirement(self.axis), *time_requirements(self.angle, "angle")]

    def placed(self, bodies, find):
        """Directions across the axis on both bodies."""
        del find
        axis = unit(self.axis)
        across = perpendicular(axis)
        first, second = self.bodies
        on_first = (turned(bodies, first, across), turned(bodies, first, cross(axis, across)))
        return PlacedRotationDriver(self.bodies, on_first, turned(bodies, second, across), self.angle)


class PlacedRotationDriver(AbstractPlacedJoint):
    """A prescribed angle, in body axes.

    Attributes:
        bodies: names of the two bodies.
        across: u and v on the first body.
        pointer: p on the second body.
        angle: [rad] by time.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    across: tuple[Numeric, Numeric]
    pointer: Numeric
    angle: AbstractFunction
    is_driven = True
    effort_unit = "N m"

    @property
    def functions_of_time(self):
        """The angle."""
        return (self.angle,)

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The centers of mass: a torque has no point."""
        return np.zeros(3), np.zeros(3)

    @property
    def n_rows(self) -> int:
        """One."""
        return 1

    def constraint_rows(self, t, motions):
        """The sine of the angle that is missing."""

        def residual(t, first, second):
            return jnp.stack([self._sine_and_cosine(t, first, second)[0]])

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]])

    def assembly_rows(self, t, motions):
        """The angle itself that is missing, between -pi and pi, so that any start finds the right branch."""

        def residual(t, first, second):
            sine, cosine = self._sine_and_cosine(t, first, second)
            has_direction = sine * sine + cosine * cosine > 0
            return jnp.stack([jnp.arctan2(sine, jnp.where(has_direction, cosine, 1.0))])

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]])

    def _sine_and_cosine(self, t, first, second):
        u, v = (first.rotation @ direction for direction in self.across)
        pointer, angle = second.rotation @ self.pointer, self.angle(t)
        sine, cosine = jnp.sin(angle), jnp.cos(angle)
        return pointer @ (cosine * v - sine * u), pointer @ (cosine * u + sine * v)


class TranslationDriver(AbstractPairJoint):
    """How far the second body has moved along an axis of the first is prescribed: one constraint equation.

        Phi = a . d - travel(t) [m]

    Attributes:
        bodies: names of the two bodies.
        axis: a, fixed in the first body, world axes at the start, any length, shape (3,).
        travel: a function of time t [s] in jnp, in m; 0 is the place of the described start. Smooth to the second
            derivative.
        rate: given instead of travel, a speed by time: a number [m/s], or a function of time; as of a `RotationDriver`.
        start: with rate, the travel at t = 0 [m].
        point: where d is measured, world axes at the start [m], shape (3,), or its name `"body.point"`: from this
            point of the first body to the same point of the second.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    axis: Triple
    travel: AbstractFunction
    point: Triple | None
    point_name: str | None = eqx.field(static=True)

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        axis: Annotated[Triple, Unit("1")],
        travel: Annotated[Callable | None, Function("s", "m")] = None,
        rate: Annotated[Number | Callable | None, Unit("m/s"), Function("s", "m/s")] = None,
        start: Annotated[Number, Unit("m")] = 0.0,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)
        self.axis = numbers(axis)
        self.travel = prescribed_by(travel, "travel", rate, start)

    def requirements(self) -> list[Requirement]:
        """A direction, a finite point, and a function that gives one number."""
        return [
            *point_requirements(self.point),
            direction_requirement(self.axis),
            *time_requirements(self.travel, "travel"),
        ]

    def placed(self, bodies, find):
        """The axis and the points in body axes."""
        places = places_of(bodies, find, self.bodies, self.point_name, self.point)
        return PlacedTranslationDriver(
            self.bodies, places, turned(bodies, self.bodies[0], unit(self.axis)), self.travel
        )


class PlacedTranslationDriver(AbstractPlacedAtPoints):
    """A prescribed translation, in body axes.

    Attributes:
        bodies: names of the two bodies.
        places: the point on each body, body axes [m].
        axis: on the first body, unit length.
        travel: [m] by time.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    axis: Numeric
    travel: AbstractFunction
    is_driven = True

    @property
    def functions_of_time(self):
        """The travel."""
        return (self.travel,)

    @property
    def n_rows(self) -> int:
        """One."""
        return 1

    def constraint_rows(self, t, motions):
        """The travel that is missing."""

        def residual(t, first, second):
            d = point_motion(second, self.places[1]).position - point_motion(first, self.places[0]).position
            return jnp.stack([(first.rotation @ self.axis) @ d - self.travel(t)])

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]])


class PositionDriver(AbstractJoint):
    """The position of a point is prescribed: three constraint equations.

        Phi = r - position(t) [m]

    Attributes:
        point: `"body.point"`.
        position: a function of time t [s] in jnp that gives three numbers: the place in the world [m], or, with
            `body`, the place in the world axes of the start as that body has carried them along. Smooth to the second
            derivative.
        body: the body against which the point is driven.
    """

    point: str = eqx.field(static=True)
    position: AbstractFunction
    body: str = eqx.field(static=True)

    def __init__(
        self,
        point: Annotated[str, Named.POINT],
        position: Annotated[Callable, OWN],
        body: Annotated[str, Named.BODY] = "ground",
    ):
        self.point = point
        self.position = prescribed(position, "position")
        self.body = body

    def joined(self, find):
        """The body that the point is driven against, then the point's."""
        return self.body, find(self.point)[0]

    def requirements(self) -> list[Requirement]:
        """A function that gives three numbers."""
        return time_requirements(self.position, "position", (3,))

    def placed(self, bodies, find):
        """The point on its body, and where the world of the start is on the other."""
        owner, place = find(self.point)
        return PlacedPositionDriver((self.body, owner), place, *world_at_start(bodies, self.body), self.position)


class PlacedPositionDriver(AbstractPlacedJoint):
    """A prescribed position, in body axes.

    Attributes:
        bodies: names of the body that it is driven against and of the point's.
        place: the point on its body, body axes [m].
        origin: the world's origin at the start, on the first body, body axes [m].
        axes: the world's axes at the start, on the first body, body axes.
        position: [m] by time.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    place: Numeric
    origin: Numeric
    axes: tuple[Numeric, Numeric, Numeric]
    position: AbstractFunction
    is_driven = True

    @property
    def functions_of_time(self):
        """The position."""
        return (self.position,)

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The world's origin at the start on the first body, and the point."""
        return self.origin, self.place

    @property
    def n_rows(self) -> int:
        """Three."""
        return 3

    def constraint_rows(self, t, motions):
        """From where the point should be to where it is, world axes."""

        def residual(t, first, second):
            wanted = self.position(t)
            place = self.origin + sum(wanted[k] * jnp.asarray(axis) for k, axis in enumerate(self.axes))
            return point_motion(second, self.place).position - point_motion(first, place).position

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]])
