"""The revolute joint."""

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Numeric
from spherejax.physics.bodies import numbers
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.elastic import model_requirements, with_model
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.places import AbstractPairJoint, AbstractPlacedJoint
from spherejax.physics.joints.placing import (
    cross,
    direction_requirement,
    perpendicular,
    places_of,
    point_requirements,
    split_point,
    turned,
    unit,
)
from spherejax.physics.joints.rows import coincidence_rows, perpendicularity_row, stacked


class Revolute(AbstractPairJoint):
    """Two bodies turn against each other about one axis: five constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: a point on the axis, world axes at the start [m], shape (3,); None where it is given by name.
        point_name: its name, where it is given by name (`point="body.point"`).
        axis: direction of the axis, world axes at the start, any length, shape (3,).
        model: `Ideal()`, or `Bushing(law=...)` with a law that resists rotation, in axes with z along the axis.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Numeric | None
    point_name: str | None = eqx.field(static=True)
    axis: Numeric
    model: AbstractSphericalModel

    def __init__(self, bodies: tuple[str, str], point, axis, model: AbstractSphericalModel | None = None):
        self.bodies = (bodies[0], bodies[1])
        self.point_name, self.point = split_point(point)
        self.axis = numbers(axis)
        self.model = Ideal() if model is None else model

    def requirements(self) -> list[Requirement]:
        """A finite point, a direction, and a model for a joint that turns freely."""
        return [
            *point_requirements(self.point),
            direction_requirement(self.axis),
            *model_requirements(self.model, turns_freely=True),
        ]

    def placed(self, bodies, find):
        """The axis in body axes; on the first body by two perpendicular directions."""
        first, second = self.bodies
        axis = unit(self.axis)
        across = perpendicular(axis)
        ideal = PlacedRevolute(
            self.bodies,
            places_of(bodies, find, self.bodies, self.point_name, self.point),
            (turned(bodies, first, across), turned(bodies, first, cross(axis, across))),
            turned(bodies, second, axis),
        )
        return with_model(ideal, self.model, bodies, axis)


class PlacedRevolute(AbstractPlacedJoint):
    """A revolute joint in body axes.

    Attributes:
        bodies: names of the two bodies.
        places: the point on each body, body axes [m].
        perpendiculars: two directions on the first body that stay perpendicular to the axis.
        axis: the axis on the second body, body axes, unit length.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    places: tuple[Numeric, Numeric]
    perpendiculars: tuple[Numeric, Numeric]
    axis: Numeric

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The joint's point on each body."""
        return self.places

    @property
    def n_rows(self) -> int:
        """Five."""
        return 5

    def constraint_rows(self, t, motions):
        """The points coincide and the axis stays perpendicular to two directions."""
        del t
        first, second = motions[self.bodies[0]], motions[self.bodies[1]]
        return stacked(
            coincidence_rows(first, second, *self.places),
            *(perpendicularity_row(first, second, b, self.axis) for b in self.perpendiculars),
        )
