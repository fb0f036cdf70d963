"""Joints about one axis: revolute, cylindrical, prismatic.

Point and axis are given in world axes at the start. On the first body the equations use directions that turn with it.
"""

import abc
from typing import Annotated, ClassVar

import equinox as eqx

from spherejax.foundations.checks import Requirement
from spherejax.foundations.forms import two_names
from spherejax.foundations.types import Named, Numeric, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.body_axes import (
    direction_requirement,
    places_of_two,
    point_requirements,
    split_point,
    split_second,
    turned,
    unit,
)
from spherejax.physics.joints.elastic import model_requirements, with_model
from spherejax.physics.joints.elementary import (
    Directions,
    PlacedPair,
    RightAngles,
    right_angles_of_all_axes,
    two_across,
)
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractPairJoint
from spherejax.physics.joints.reaction_friction import ShaftFriction


class AbstractAxialJoint(AbstractPairJoint):
    """A joint of two bodies at a point of an axis.

    Attributes:
        bodies: names of the two bodies.
        point: a point on the axis, world axes at the start [m], shape (3,); None where it is given by name.
        point_name: its name, where it is given by name (`point="body.point"`).
        axis: direction of the axis, world axes at the start, any length, shape (3,).
        model: `Ideal(...)`, or `Bushing(law=...)` with a law that resists rotation, in axes with z along the axis.
        starts_concentric: whether a bushing starts relaxed, the start being assembled as if the joint were ideal;
            False leaves the bodies, and their velocities, as they are described.
        second_point: the joint's point on the second body, where it is not `point` in the described start: numbers as
            of `point`, shape (3,); None where it is `point`, or given by name.
        second_point_name: its name, where it is given by name.
        turns_freely: whether the joint turns about its axis (static).
        is_bearing: whether it may have clearance, as a journal in a bearing (static).
        slides_freely: whether it slides along it (static).

    Classes below repeat the constructor's arguments: a type checker makes a constructor from the fields otherwise.
    """

    turns_freely: ClassVar[bool]
    slides_freely: ClassVar[bool]
    is_bearing: ClassVar[bool] = False

    bodies: tuple[str, str] = eqx.field(static=True)
    point: Triple | None
    point_name: str | None = eqx.field(static=True)
    axis: Triple
    model: AbstractSphericalModel
    starts_concentric: bool = eqx.field(static=True)
    second_point: Triple | None
    second_point_name: str | None = eqx.field(static=True)

    def __init__(
        self,
        bodies: tuple[str, str],
        point,
        axis,
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        second_point=None,
    ):
        self.bodies = two_names("bodies", bodies, '("ground", "arm")')
        self.point_name, self.point = split_point(point)
        self.axis = numbers(axis)
        self.model = Ideal() if model is None else model
        self.starts_concentric = starts_concentric
        self.second_point_name, self.second_point = split_second(second_point)

    def as_described(self):
        """The joint with a bushing that may be pressed at the start."""
        point = self.point if self.point_name is None else self.point_name
        second = self.second_point if self.second_point_name is None else self.second_point_name
        return type(self)(self.bodies, point, self.axis, self.model, starts_concentric=False, second_point=second)

    def requirements(self) -> list[Requirement]:
        """A finite point, a direction, and a model for such a joint."""
        return [
            *point_requirements(self.point),
            *point_requirements(self.second_point, "second_point"),
            direction_requirement(self.axis),
            *model_requirements(
                self.model, turns_freely=self.turns_freely, slides=self.slides_freely, is_bearing=self.is_bearing
            ),
        ]

    def placed(self, bodies, find):
        """The joint's equations in body axes, or a ball in a socket that stands for them."""
        places = places_of_two(bodies, find, self)
        axis = unit(self.axis)
        across = two_across(bodies, self.bodies[0], axis)
        on_second = turned(bodies, self.bodies[1], axis)
        axis_stays = tuple((b, on_second) for b in across)
        coincides, right_angles = self._equations(bodies, axis, axis_stays)
        normals = () if coincides else across
        rubbing = None
        if isinstance(self.model, Ideal) and self.model.friction is not None:
            rubbing = ShaftFriction(self.model, on_second, self.turns_freely, self.slides_freely)
        ideal = PlacedPair(self.bodies, places, coincides, normals, right_angles, (on_second,), rubbing)
        held = self._held_with_clearance(turned(bodies, self.bodies[0], axis), axis_stays)
        guide = None if held is None else PlacedPair(self.bodies, places, False, *held, (on_second,))
        return with_model(ideal, self.model, self.starts_concentric, bodies, axis, guide=guide)

    @abc.abstractmethod
    def _equations(self, bodies, axis, axis_stays) -> tuple[bool, RightAngles]:
        """Whether the points coincide, rather than stay on the axis; and the right angles that stay.

        Args:
            bodies: the scene's bodies.
            axis: world axes at the start, unit length.
            axis_stays: the right angles that keep the axis of the second body along that of the first.
        """

    def _held_with_clearance(self, along, axis_stays) -> tuple[Directions, RightAngles] | None:
        """What guides a journal with clearance: normals of planes on the first body, and right angles; None: nothing.

        Args:
            along: the axis on the first body.
            axis_stays: as for `_equations`.
        """
        del along, axis_stays
        return None


class Revolute(AbstractAxialJoint):
    """Two bodies turn against each other about one axis: five constraint equations.

    With `Dry(...)` or `Lubricated(...)` as model it is a journal in a bearing with clearance: held along the axis and
    parallel to it (three equations), and free across it until the model answers. Both bodies' radii, materials and laws
    are those of the model; the first body carries the bearing.

    Attributes:
        bodies: names of the two bodies.
        point: a point on the axis, world axes at the start [m], shape (3,); None where it is given by name.
        point_name: its name, where it is given by name (`point="body.point"`).
        axis: direction of the axis, world axes at the start, any length, shape (3,).
        model: `Ideal(...)`; `Bushing(law=...)` with a law that resists rotation, in axes with z along the axis;
            `Dry(...)` with the contact of a cylinder (`conformity=sj.laws.JohnsonCylinder(length)`) or a given
            stiffness; `Lubricated(...)` with a bearing's film as well (`film=sj.laws.ShortBearing(length)`).
        starts_concentric: whether a bushing starts relaxed and a journal in the middle, the start being assembled as if
            the joint were ideal; False leaves the bodies, and their velocities, as they are described.
        second_point: of a journal its center, so that it may start beside that of the bearing (with
            `starts_concentric=False`); of other joints as of `AbstractAxialJoint`.

    Limits: without `second_point` the bearing's center is the journal's, wherever the bodies are. A journal then starts
    in the middle, with `starts_concentric=False` too; what that leaves are velocities across the axis.
    """

    turns_freely = True
    is_bearing = True
    slides_freely = False

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        axis: Annotated[Triple, Unit("1")],
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        second_point: Annotated[Numeric | None, Named.PLACE] = None,
    ):
        super().__init__(bodies, point, axis, model, starts_concentric, second_point)

    def _equations(self, bodies, axis, axis_stays):
        return True, axis_stays

    def _held_with_clearance(self, along, axis_stays):
        return (along,), axis_stays


class Cylindrical(AbstractAxialJoint):
    """Two bodies turn about one axis and slide along it: four constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: a point on the axis, world axes at the start [m], shape (3,), or its name `"body.point"`.
        axis: direction of the axis, world axes at the start, any length, shape (3,).
        model: `Ideal(...)`, or `Bushing(law=...)` with a law that resists rotation, in axes with z along the axis.
        starts_concentric: whether a bushing starts relaxed, the start being assembled as if the joint were ideal;
            False leaves the bodies, and their velocities, as they are described.
        second_point: the joint's point on the second body, where it is not `point` in the described start: the start is
            then closed, and a `StartWarning` says what was moved.
    """

    turns_freely = True
    slides_freely = True

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        axis: Annotated[Triple, Unit("1")],
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        second_point: Annotated[Numeric | None, Named.PLACE] = None,
    ):
        super().__init__(bodies, point, axis, model, starts_concentric, second_point)

    def _equations(self, bodies, axis, axis_stays):
        return False, axis_stays


class Prismatic(AbstractAxialJoint):
    """Two bodies slide along one axis without turning: five constraint equations.

    Attributes:
        bodies: names of the two bodies.
        point: where the bodies meet at the start, world axes at the start [m], shape (3,), or its name
            `"body.point"`; reactions are about it.
        axis: direction of sliding, world axes at the start, any length, shape (3,).
        model: `Ideal(...)`, or `Bushing(law=...)` with a law that resists rotation, in axes with z along the axis.
        starts_concentric: whether a bushing starts relaxed, the start being assembled as if the joint were ideal;
            False leaves the bodies, and their velocities, as they are described.
        second_point: the joint's point on the second body, where it is not `point` in the described start: the start is
            then closed, and a `StartWarning` says what was moved.
    """

    turns_freely = False
    slides_freely = True

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        axis: Annotated[Triple, Unit("1")],
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        second_point: Annotated[Numeric | None, Named.PLACE] = None,
    ):
        super().__init__(bodies, point, axis, model, starts_concentric, second_point)

    def _equations(self, bodies, axis, axis_stays):
        return False, right_angles_of_all_axes(bodies, self.bodies, axis)
