"""A point of one body on a curve of another."""

import abc
from collections.abc import Callable
from typing import Annotated

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import OWN, Named, Number, Numeric, Triple, Unit, Vector3
from spherejax.physics.bodies import numbers
from spherejax.physics.functions.base import Given
from spherejax.physics.joints.body_axes import (
    cross,
    direction_requirement,
    perpendicular,
    point_requirements,
    world_at_start,
)
from spherejax.physics.joints.joint import AbstractJoint, AbstractPlacedJoint
from spherejax.physics.joints.rows import differentiated_rows
from spherejax.physics.kinematics import point_motion


class AbstractCurve(eqx.Module):
    """A smooth curve in space: where two functions of the place vanish.

    A curve of one's own implements `residual` in jnp, in world axes at the start; derivatives are made from it.
    """

    @abc.abstractmethod
    def residual(self, place: Vector3) -> Float[Array, "2"]:
        """Two functions that vanish on the curve, and whose gradients there are independent.

        Args:
            place: in the world axes of the start, turned and moved with the curve's body since [m].

        Returns:
            Best in meters, like a distance from the curve, so that tolerances mean what they say.
        """

    def requirements(self) -> list[Requirement]:
        """What the curve's numbers must satisfy."""
        return []


class Circle(AbstractCurve):
    """A circle: what a massless arm that turns about an axis lets its end reach.

        residual = (a . p, (p.p/R - R)/2),    p from the center to the place, a the unit vector along the axis

    Attributes:
        center: world axes at the start [m], shape (3,).
        axis: direction perpendicular to the circle's plane, any length, shape (3,).
        radius: R [m].
    """

    center: Triple
    axis: Triple
    radius: Number

    def __init__(
        self,
        center: Annotated[Triple, Unit("m")],
        axis: Annotated[Triple, Unit("1")],
        radius: Annotated[Number, Unit("m")],
    ):
        self.center = numbers(center)
        self.axis = numbers(axis)
        self.radius = radius

    def residual(self, place):
        """Height over the plane, and distance from the circle's cylinder."""
        p = place - self.center
        axis = self.axis / jnp.sqrt((self.axis**2).sum())
        return jnp.stack([axis @ p, (p @ p / self.radius - self.radius) / 2])

    def requirements(self):
        """A finite center, a direction, a positive radius."""
        remedy = "Give the distance of the point from the axis."
        return [
            *point_requirements(self.center, "center"),
            direction_requirement(self.axis),
            Requirement("radius", self.radius, (self.radius > 0) & (self.radius < np.inf), "be positive [m]", remedy),
        ]


class Line(AbstractCurve):
    """A straight line.

    Attributes:
        through: a point of it, world axes at the start [m], shape (3,).
        direction: any length, shape (3,).
    """

    through: Triple
    direction: Triple

    def __init__(self, through: Annotated[Triple, Unit("m")], direction: Annotated[Triple, Unit("1")]):
        self.through = numbers(through)
        self.direction = numbers(direction)

    def residual(self, place):
        """Distances from two planes through the line."""
        along = self.direction / (self.direction**2).sum() ** 0.5
        across = perpendicular(along)
        p = place - self.through
        return jnp.stack([p @ across, p @ cross(along, across)])

    def requirements(self):
        """A finite point and a direction."""
        return [*point_requirements(self.through, "through"), direction_requirement(self.direction, "direction")]


class ImplicitCurve(AbstractCurve):
    """The curve where a function of the place vanishes, given as a plain function.

    Attributes:
        function: takes a place [m], shape (3,), and returns two numbers.
    """

    function: Given

    def __init__(self, function: Annotated[Callable, OWN]):
        self.function = Given(function)

    def residual(self, place):
        """The function's value."""
        return jnp.asarray(self.function(place))


class PointOnCurve(AbstractJoint):
    """A point of one body stays on a curve of another: two constraint equations.

    Attributes:
        point: `"body.point"`, the point that stays on the curve.
        curve: `Circle`, `Line`, `ImplicitCurve`, or one's own; in world axes at the start.
        body: the body that carries the curve along.
    """

    point: str = eqx.field(static=True)
    curve: AbstractCurve
    body: str = eqx.field(static=True)

    def __init__(
        self, point: Annotated[str, Named.POINT], curve: AbstractCurve, body: Annotated[str, Named.BODY] = "ground"
    ):
        self.point = point
        self.curve = curve
        self.body = body

    def joined(self, find):
        """The curve's body, then the point's."""
        return self.body, find(self.point)[0]

    def requirements(self) -> list[Requirement]:
        """A curve that gives two numbers, and what it requires.

        Raises:
            SceneError: for a curve whose function cannot be evaluated.
        """
        if not isinstance(self.curve, AbstractCurve):
            raise SceneError(
                f"curve = {self.curve!r} is no curve; give Circle(...), Line(...), ImplicitCurve(function), or an "
                "AbstractCurve of your own"
            )
        try:
            found = jax.eval_shape(self.curve.residual, jax.ShapeDtypeStruct((3,), jnp.float64)).shape
        except Exception as error:
            raise SceneError(
                f"the curve {type(self.curve).__name__} cannot be evaluated ({error}). Write its function in "
                "jax.numpy, for a place of shape (3,)"
            ) from error
        remedy = "A curve is where two functions of the place vanish."
        return [
            Requirement("residual(place).shape", found, found == (2,), "be (2,)", remedy),
            *self.curve.requirements(),
        ]

    def placed(self, bodies, find):
        """The point on its body, and where the world of the start is on the curve's body."""
        owner, place = find(self.point)
        return PlacedPointOnCurve((self.body, owner), place, *world_at_start(bodies, self.body), self.curve)


class PlacedPointOnCurve(AbstractPlacedJoint):
    """A point on a curve, in body axes.

    Attributes:
        bodies: names of the curve's and of the point's body.
        place: the point on its body, body axes [m].
        origin: the world's origin at the start, on the curve's body, body axes [m].
        axes: the world's axes at the start, on the curve's body, body axes.
        curve: the curve, in world axes at the start.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    place: Numeric
    origin: Numeric
    axes: tuple[Numeric, Numeric, Numeric]
    curve: AbstractCurve

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The world's origin at the start on the curve's body, and the point."""
        return self.origin, self.place

    @property
    def n_rows(self) -> int:
        """Two."""
        return 2

    def constraint_rows(self, t, motions):
        """The curve's two functions at the point."""

        def residual(t, carrier, body):
            del t
            away = point_motion(body, self.place).position - point_motion(carrier, self.origin).position
            on_body = carrier.rotation.T @ away
            return self.curve.residual(jnp.stack([jnp.asarray(axis) @ on_body for axis in self.axes]))

        return differentiated_rows(residual, t, motions[self.bodies[0]], motions[self.bodies[1]], is_driven=False)
