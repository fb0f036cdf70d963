"""A journal that tilts in its bearing until it touches the rims: one joint for each rim.

A cylinder that is tilted by a small angle in a cylinder touches it at the ends first, and there, in the plane of a rim,
both are circles again, up to the square of the angle: each rim is the contact of two circles across the bearing's axis,
with modes, landings and memory of its own.
"""

from typing import Annotated

import equinox as eqx

from spherejax.foundations.checks import Requirement, enforce
from spherejax.foundations.legal import positive
from spherejax.foundations.types import Named, Number, Numeric, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.joints.axial import AbstractAxialJoint
from spherejax.physics.joints.base import AbstractSphericalModel, Medium
from spherejax.physics.joints.body_axes import direction_requirement, unit
from spherejax.physics.joints.clearance import AbstractClearanceModel
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.laws.cylinders import AbstractCylinder


class Rim(AbstractAxialJoint):
    """The circle of a journal in a rim of its bearing: it moves across the bearing's axis, and turns, tilts and slides.

    Two of them, half a length apart on either side, are a journal that tilts: see `tilting_journal`. With `Dry(...)`
    the journal is free until it touches; the force acts across the bearing's axis, where the journal's circle is. With
    `Ideal()` the journal's point stays on the axis: two constraint equations.

    Attributes:
        bodies: names of the bearing's and of the journal's body.
        point: the rim's center, world axes at the start [m], shape (3,); None where it is given by name.
        point_name: its name, where it is given by name (`point="body.point"`).
        axis: direction of the bearing's axis, world axes at the start, any length, shape (3,).
        model: `Ideal()`, or `Dry(...)` with the contact of a cylinder (`conformity=sj.laws.JohnsonCylinder(length)`) or
            a given stiffness, for the half of the bearing that belongs to this rim.
        starts_concentric: whether the start is assembled as if the joint were ideal; False leaves the bodies, and their
            velocities, as they are described.
        is_thrust: whether a collar holds the journal along the axis here: one equation more.

    Limits: right to first order in the tilt theta, which two rims hold below two clearances over the length. A run in
    which R theta^2/2 exceeds a tenth of the clearance, as a single rim allows, gives an `OutOfRangeWarning`. A film
    between tilted surfaces is not modelled, and refused.
    """

    turns_freely = True
    is_bearing = True
    slides_freely = True

    is_thrust: bool = eqx.field(static=True)

    def __init__(
        self,
        bodies: Annotated[tuple[str, str], Named.BODIES],
        point: Annotated[Numeric, Named.PLACE],
        axis: Annotated[Triple, Unit("1")],
        model: AbstractSphericalModel | None = None,
        starts_concentric: bool = True,
        is_thrust: bool = False,
    ):
        super().__init__(bodies, point, axis, model, starts_concentric)
        self.is_thrust = is_thrust

    def as_described(self):
        """The joint with a journal that starts where the bodies put it."""
        point = self.point if self.point_name is None else self.point_name
        return Rim(self.bodies, point, self.axis, self.model, False, self.is_thrust)

    def requirements(self) -> list[Requirement]:
        """As a joint about an axis; ideal without friction, or with surfaces and without a film."""
        return [*_of_rims(self.model), *super().requirements()]

    def _equations(self, bodies, axis, axis_stays):
        return self.is_thrust, ()

    def _held_with_clearance(self, along, axis_stays):
        return ((along,), ()) if self.is_thrust else None


def _of_rims(model: AbstractSphericalModel) -> list[Requirement]:
    fits = model.is_ideal or (model.has_surfaces and model.medium is not Medium.FILM)
    rubs = isinstance(model, Ideal) and model.friction is not None
    name = type(model).__name__
    remedy = "Give Dry(...) or Ideal(); a film between tilted surfaces is not modelled: Revolute has one, parallel."
    turns_oval = isinstance(model, AbstractClearanceModel) and model.surfaces.ball_depth is not None
    parallel = "Give the depth to the bearing, socket_depth=; a journal that is not round is one of Revolute, parallel."
    return [
        Requirement("ball_depth", name, not turns_oval, "be left out of a rim", parallel),
        Requirement("model", name, fits, "be ideal or dry", remedy),
        Requirement("friction", name, not rubs, "be left out of an ideal rim", "Revolute has friction by reactions."),
    ]


def _half(model: AbstractSphericalModel) -> AbstractSphericalModel:
    """The model of half a bearing: a cylinder's length, or a given stiffness, halved."""
    if isinstance(model, AbstractClearanceModel):
        if isinstance(model.conformity, AbstractCylinder):
            return eqx.tree_at(lambda m: m.conformity.length, model, 0.5 * model.conformity.length)
        if model.conformity is not None:
            raise TypeError(
                f"half of {type(model.conformity).__name__} is not known here: give each sj.joints.Rim the "
                f"contact of its half"
            )
        if model.normal.stiffness is not None:
            return eqx.tree_at(lambda m: m.normal.stiffness, model, 0.5 * model.normal.stiffness)
    return model


def tilting_journal(
    name: str,
    bodies: tuple[str, str],
    point: Triple,
    axis: Triple,
    model: AbstractSphericalModel | None = None,
    *,
    length: Number,
    starts_concentric: bool = True,
) -> dict[str, Rim]:
    """A journal with clearance that tilts in its bearing, as two rims: joints of a scene.

        joints = {"crank": sj.Revolute(...), **sj.joints.tilting_journal("pin", bodies, at, along, model, length=0.02)}

    The rims are `NAME_1` and `NAME_2`, half a length before and behind the point along the axis; the first holds the
    journal along the axis. Each has half of the contact: that of a cylinder of half the length, or half of a given
    stiffness, so that a journal that stays parallel moves as in `Revolute`.

    Args:
        name: of the joint.
        bodies: names of the bearing's and of the journal's body.
        point: the middle of the bearing, world axes at the start [m], shape (3,).
        axis: direction of its axis, world axes at the start, any length, shape (3,).
        model: `Ideal()`, or `Dry(...)` as for `Revolute`, for the whole bearing.
        length: of the bearing [m].
        starts_concentric: see `Rim`.

    Returns:
        The joints by name.
    """
    enforce(f"journal {name!r}", [positive("length", length, "m"), direction_requirement(numbers(axis))])
    model = _half(Ideal() if model is None else model)
    point, axis = numbers(point), unit(numbers(axis))
    places = (point - 0.5 * length * axis, point + 0.5 * length * axis)
    return {
        f"{name}_{i + 1}": Rim(bodies, place, axis, model, starts_concentric, is_thrust=i == 0)
        for i, place in enumerate(places)
    }
