"""Joints that hold directions of two bodies together and leave places free: the primitives of other programs.

With `PointOnPlane` and `PointOnCurve` they make any joint that slides along some axes and turns about others, as a
carriage on two rails. Points and axes are given in world axes at the start.
"""

import abc
from typing import Annotated

import equinox as eqx
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.forms import two_names
from spherejax.foundations.types import Named, Numeric, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.joints.body_axes import (
    direction_requirement,
    places_of,
    point_requirements,
    right_angle_requirement,
    split_point,
    turned,
    unit,
)
from spherejax.physics.joints.elementary import PlacedPair, RightAngles, right_angles_of_all_axes, two_across
from spherejax.physics.joints.joint import AbstractPairJoint


class AbstractOrientationJoint(AbstractPairJoint):
    """A joint that answers with a moment alone.

    Attributes:
        bodies: names of the two bodies.
        point: where it is drawn, world axes at the start [m], shape (3,); None where it is given by name.
        point_name: its name, where it is given by name (`point="body.point"`).
    """

    bodies: eqx.AbstractVar[tuple[str, str]]
    point: eqx.AbstractVar[Triple | None]
    point_name: eqx.AbstractVar[str | None]

    @abc.abstractmethod
    def _right_angles(self, bodies) -> RightAngles:
        """The right angles that stay."""

    def requirements(self) -> list[Requirement]:
        """A finite point."""
        return point_requirements(self.point)

    def placed(self, bodies, find):
        """Right angles in body axes."""
        places = places_of(bodies, find, self.bodies, self.point_name, self.point)
        return PlacedPair(self.bodies, places, False, (), self._right_angles(bodies), ())


class SameOrientation(AbstractOrientationJoint):
    """Two bodies do not turn against each other, and move freely: three constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: where it is drawn, world axes at the start [m], shape (3,), or its name `"body.point"`; the joint's
            moment does not depend on it.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Triple | None
    point_name: str | None = eqx.field(static=True)

    def __init__(self, bodies: Annotated[tuple[str, str], Named.BODIES], point: Annotated[Numeric, Named.PLACE]):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)

    def _right_angles(self, bodies):
        return right_angles_of_all_axes(bodies, self.bodies, np.array([0.0, 0.0, 1.0]))


class ParallelAxes(AbstractOrientationJoint):
    """Two bodies turn against each other about one direction, and move freely: two constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: where it is drawn, world axes at the start [m], shape (3,), or its name `"body.point"`; the joint's
            moment does not depend on it.
        axis: the direction that stays common, world axes at the start, any length, shape (3,).
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Triple | None
    point_name: str | None = eqx.field(static=True)
    axis: Triple

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        axis: Annotated[Triple, Unit("1")],
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)
        self.axis = numbers(axis)

    def requirements(self) -> list[Requirement]:
        """A finite point and a direction."""
        return [*point_requirements(self.point), direction_requirement(self.axis)]

    def _right_angles(self, bodies):
        on_second = turned(bodies, self.bodies[1], unit(self.axis))
        return tuple((across, on_second) for across in two_across(bodies, self.bodies[0], self.axis))


class PerpendicularAxes(AbstractOrientationJoint):
    """A direction of one body stays perpendicular to one of another; they move freely: one constraint equation.

    Attributes:
        bodies: names of the two bodies.
        point: where it is drawn, world axes at the start [m], shape (3,), or its name `"body.point"`; the joint's
            moment does not depend on it.
        first_axis: the direction of the first body, world axes at the start, any length, shape (3,).
        second_axis: the direction of the second body, perpendicular to the first.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Triple | None
    point_name: str | None = eqx.field(static=True)
    first_axis: Triple
    second_axis: Triple

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        first_axis: Annotated[Triple, Unit("1")],
        second_axis: Annotated[Triple, Unit("1")],
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)
        self.first_axis = numbers(first_axis)
        self.second_axis = numbers(second_axis)

    def requirements(self) -> list[Requirement]:
        """A finite point and two perpendicular directions."""
        return [
            *point_requirements(self.point),
            direction_requirement(self.first_axis, "first_axis"),
            direction_requirement(self.second_axis, "second_axis"),
            right_angle_requirement(self.first_axis, self.second_axis, "Give the two directions at the start."),
        ]

    def _right_angles(self, bodies):
        first, second = unit(self.first_axis), unit(self.second_axis)
        return ((turned(bodies, self.bodies[0], first), turned(bodies, self.bodies[1], second)),)
