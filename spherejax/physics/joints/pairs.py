"""Joints of two bodies without a common axis: universal, fixed, and a point on a plane.

Points and axes are given in world axes at the start.
"""

from typing import Annotated

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.foundations.forms import two_names
from spherejax.foundations.types import Named, Numeric, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.body_axes import (
    direction_requirement,
    places_of,
    places_of_two,
    point_requirements,
    right_angle_requirement,
    split_point,
    split_second,
    turned,
    unit,
)
from spherejax.physics.joints.elastic import model_requirements, with_model
from spherejax.physics.joints.elementary import PlacedPair, right_angles_of_all_axes
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractJoint, AbstractPairJoint
from spherejax.physics.joints.reaction_friction import CrossFriction


class Universal(AbstractPairJoint):
    """Two bodies joined by a cross: each turns about its own arm of it; four constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: the center of the cross, world axes at the start [m], shape (3,), or its name `"body.point"`.
        first_axis: the arm that is fixed in the first body, world axes at the start, any length, shape (3,).
        second_axis: the arm that is fixed in the second body, perpendicular to the first.
        model: `Ideal(...)`, or `Bushing(law=...)` with a law that resists rotation, in axes with z along the first arm
            and x along the second at the start.
        starts_concentric: whether a bushing starts relaxed, the start being assembled as if the joint were ideal;
            False leaves the bodies, and their velocities, as they are described.
        second_point: the joint's point on the second body, where it is not `point` in the described start, or its
            name: the start is then closed, and a `StartWarning` says what was moved.
        second_point_name: its name, where it is given by name.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Triple | None
    point_name: str | None = eqx.field(static=True)
    first_axis: Triple
    second_axis: Triple
    model: AbstractSphericalModel
    starts_concentric: bool = eqx.field(static=True)
    second_point: Triple | None
    second_point_name: str | None = eqx.field(static=True)

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        first_axis: Annotated[Triple, Unit("1")],
        second_axis: Annotated[Triple, Unit("1")],
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        second_point: Annotated[Numeric | None, Named.PLACE] = None,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)
        self.first_axis = numbers(first_axis)
        self.second_axis = numbers(second_axis)
        self.model = Ideal() if model is None else model
        self.starts_concentric = starts_concentric
        self.second_point_name, self.second_point = split_second(second_point)

    def as_described(self):
        """The joint with a bushing that may be pressed at the start."""
        point = self.point if self.point_name is None else self.point_name
        second = self.second_point if self.second_point_name is None else self.second_point_name
        return Universal(self.bodies, point, self.first_axis, self.second_axis, self.model, False, second)

    def requirements(self) -> list[Requirement]:
        """A finite point, two perpendicular directions, and a model."""
        a, b = self.first_axis, self.second_axis
        return [
            *point_requirements(self.point),
            *point_requirements(self.second_point, "second_point"),
            direction_requirement(a, "first_axis"),
            direction_requirement(b, "second_axis"),
            right_angle_requirement(a, b, "Give the two arms of the cross at the start."),
            *model_requirements(self.model, turns_freely=True, slides=False),
        ]

    def placed(self, bodies, find):
        """The points coincide and the arms stay perpendicular."""
        places = places_of_two(bodies, find, self)
        first = turned(bodies, self.bodies[0], unit(self.first_axis))
        second = turned(bodies, self.bodies[1], unit(self.second_axis))
        rubbing = None
        if isinstance(self.model, Ideal) and self.model.friction is not None:
            rubbing = CrossFriction(self.model, first, second)
        ideal = PlacedPair(self.bodies, places, True, (), ((first, second),), (second,), rubbing)
        return with_model(ideal, self.model, self.starts_concentric, bodies, self.first_axis, self.second_axis)


class Fixed(AbstractPairJoint):
    """Two bodies move as one: six constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: a point of both, about which reactions are given, world axes at the start [m], shape (3,), or its name
            `"body.point"`.
        model: `Ideal()`, or `Bushing(law=...)` with a law that resists rotation, in the axes of the first body.
        starts_concentric: whether a bushing starts relaxed, the start being assembled as if the joint were ideal;
            False leaves the bodies, and their velocities, as they are described.
        second_point: the joint's point on the second body, where it is not `point` in the described start, or its
            name: the start is then closed, and a `StartWarning` says what was moved.
        second_point_name: its name, where it is given by name.
    """

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Triple | None
    point_name: str | None = eqx.field(static=True)
    model: AbstractSphericalModel
    starts_concentric: bool = eqx.field(static=True)
    second_point: Triple | None
    second_point_name: str | None = eqx.field(static=True)

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        second_point: Annotated[Numeric | None, Named.PLACE] = None,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)
        self.model = Ideal() if model is None else model
        self.starts_concentric = starts_concentric
        self.second_point_name, self.second_point = split_second(second_point)

    def as_described(self):
        """The joint with a bushing that may be pressed at the start."""
        point = self.point if self.point_name is None else self.point_name
        second = self.second_point if self.second_point_name is None else self.second_point_name
        return Fixed(self.bodies, point, self.model, False, second)

    def requirements(self) -> list[Requirement]:
        """A finite point and a model."""
        return [
            *point_requirements(self.point),
            *point_requirements(self.second_point, "second_point"),
            *model_requirements(self.model, turns_freely=False, slides=False),
        ]

    def placed(self, bodies, find):
        """The points coincide and three right angles stay."""
        places = places_of_two(bodies, find, self)
        angles = right_angles_of_all_axes(bodies, self.bodies, numbers((0.0, 0.0, 1.0)))
        ideal = PlacedPair(self.bodies, places, True, (), angles, ())
        return with_model(ideal, self.model, self.starts_concentric, bodies)


class PointOnPlane(AbstractJoint):
    """A point of one body stays in a plane of another: one constraint equation.

    Attributes:
        point: `"body.point"`, the point that stays in the plane.
        body: the body that the plane belongs to.
        through: a point of the plane, world axes at the start [m], shape (3,), or its name `"body.point"`.
        normal: the plane's normal, world axes at the start, any length, shape (3,).
    """

    point: str = eqx.field(static=True)
    body: str = eqx.field(static=True)
    through: Triple | None
    through_name: str | None = eqx.field(static=True)
    normal: Triple

    def __init__(
        self,
        point: Annotated[str, Named.POINT],
        through: Annotated[Numeric, Named.PLACE],
        normal: Annotated[Triple, Unit("1")],
        body: Annotated[str, Named.BODY] = "ground",
    ):
        self.point = point
        self.body = body
        self.through_name, self.through = split_point(through)
        self.normal = numbers(normal)

    def joined(self, find):
        """The plane's body, then the point's."""
        return self.body, find(self.point)[0]

    def requirements(self) -> list[Requirement]:
        """A finite point and a direction."""
        return [*point_requirements(self.through, "through"), direction_requirement(self.normal, "normal")]

    def placed(self, bodies, find):
        """Plane and point in body axes."""
        owner, place = find(self.point)
        pair = (self.body, owner)
        through = places_of(bodies, find, pair, self.through_name, self.through)[0]
        normal = turned(bodies, self.body, unit(self.normal))
        return PlacedPair(pair, (through, place), False, (normal,), (), ())
