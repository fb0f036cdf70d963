"""A journal that tilts in its bearing until it touches the rims: one joint for each rim.

A cylinder that is tilted by a small angle in a cylinder touches it at the ends first, and there, in the plane of a rim,
both are circles again, up to the square of the angle: each rim is the contact of two circles across the bearing's axis,
with modes, landings and memory of its own.

A bearing that presses, or is worn, differently along its axis has such a contact in further planes between the rims.
The planes are the nodes of Lobatto's rule, and each stands for its weight's share of the bearing's length L:

    F = L int q ds  ->  sum_i w_i L q(s_i),    s = 2 z/L from -1 to 1,    s_1 = -1, s_n = 1

which is exact for a load q per length that is a polynomial of degree 2 n - 3 along the axis.
"""

from typing import Annotated

import equinox as eqx
import numpy as np
from jaxtyping import Float

from spherejax.foundations.checks import Requirement, enforce
from spherejax.foundations.errors import SceneError
from spherejax.foundations.legal import positive
from spherejax.foundations.types import Named, Number, Numeric, Triple, Unit
from spherejax.physics.bodies import numbers
from spherejax.physics.joints.axial import AbstractAxialJoint
from spherejax.physics.joints.base import AbstractSphericalModel, Medium
from spherejax.physics.joints.body_axes import direction_requirement, unit
from spherejax.physics.joints.clearance import AbstractClearanceModel
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.laws.cylinders import AbstractCylinder
from spherejax.physics.laws.depth import LegendreFourierDepth

MOST_PLANES = 9
"""Each is a joint with an onset of its own; nine resolve a load along the axis of degree 15."""


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


def lobatto(planes: int) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Places from -1 to 1, both ends among them, and weights with the sum 1, of Lobatto's rule.

    Source: Abramowitz and Stegun (1964), 25.4.32: the zeros of P'_(n-1), weights 2/(n (n - 1) P_(n-1)^2), here halved.
    """
    last = np.polynomial.Legendre.basis(planes - 1)
    inner = np.sort(np.real(last.deriv().roots())) if planes > 2 else np.zeros(0)
    inner = 0.5 * (inner - inner[::-1])  # symmetric to rounding
    places = np.concatenate([[-1.0], inner, [1.0]])
    return places, 1.0 / (planes * (planes - 1) * last(places) ** 2)


def _share(model: AbstractSphericalModel, share: float) -> AbstractSphericalModel:
    """The model of a share of a bearing: of a cylinder's length, or of a given stiffness."""
    if isinstance(model, AbstractClearanceModel):
        if isinstance(model.conformity, AbstractCylinder):
            return eqx.tree_at(lambda m: m.conformity.length, model, share * model.conformity.length)
        if model.conformity is not None:
            raise TypeError(
                f"half of {type(model.conformity).__name__} is not known here: give each sj.joints.Rim the "
                f"contact of its half"
            )
        if model.normal.stiffness is not None:
            return eqx.tree_at(lambda m: m.normal.stiffness, model, share * model.normal.stiffness)
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
    planes: int = 2,
    socket_depth: LegendreFourierDepth | None = None,
) -> dict[str, Rim]:
    """A journal with clearance that tilts in its bearing, as two rims or more planes: joints of a scene.

        joints = {"crank": sj.Revolute(...), **sj.joints.tilting_journal("pin", bodies, at, along, model, length=0.02)}

    The rims are `NAME_1` and `NAME_2`, half a length before and behind the point along the axis; the first holds the
    journal along the axis. Each has half of the contact: that of a cylinder of half the length, or half of a given
    stiffness, so that a journal that stays parallel moves as in `Revolute`. With more planes, `NAME_1` to `NAME_n`, the
    contact is shared out along the axis by Lobatto's rule: with 3 as 1/6, 2/3, 1/6.

    Args:
        name: of the joint.
        bodies: names of the bearing's and of the journal's body.
        point: the middle of the bearing, world axes at the start [m], shape (3,).
        axis: direction of its axis, world axes at the start, any length, shape (3,).
        model: `Ideal()`, or `Dry(...)` as for `Revolute`, for the whole bearing.
        length: of the bearing [m].
        starts_concentric: see `Rim`.
        planes: how many planes of contact there are along the axis, the two rims among them, up to 9; two of an ideal
            joint, which more would hold again.
        socket_depth: how deep the bearing's surface lies below its cylinder, by angle and place along the axis: worn
            away, or not straight. Each plane has the depth that is there.

    Returns:
        The joints by name.

    Raises:
        SceneError: for a length, a direction, a number of planes or a depth that cannot be, with the remedy.
        TypeError: for a contact whose share is not known.

    Limits: two rims have a journal that is pressed all along its bearing tilt three times as stiffly as line contact
    does; from three planes on a load that is linear along the axis is exact. A journal that touches along a part of a
    plane's share touches along all of it or not at all.
    """
    places, shares = _checked_planes(name, length, axis, model, planes, socket_depth)
    model = Ideal() if model is None else model
    point, axis = numbers(point), unit(numbers(axis))
    return {
        f"{name}_{i + 1}": Rim(
            bodies,
            point + 0.5 * place * length * axis,
            axis,
            _with_depth(_share(model, share), socket_depth, place),
            starts_concentric,
            is_thrust=i == 0,
        )
        for i, (place, share) in enumerate(zip(places.tolist(), shares.tolist(), strict=True))
    }


def _with_depth(model, depth: LegendreFourierDepth | None, place: float):
    if depth is None:
        return model
    return eqx.tree_at(lambda m: m.socket_depth, model, depth.at(place), is_leaf=lambda leaf: leaf is None)


def _checked_planes(name, length, axis, model, planes, depth):
    """Places and shares of the planes, once what the whole bearing is made of is legal."""
    is_whole = isinstance(planes, int | np.integer) and not isinstance(planes, bool)
    if not (is_whole and 2 <= planes <= MOST_PLANES):
        raise SceneError(
            f"journal {name!r}: planes = {planes!r} must be a whole number from 2, the two rims, to {MOST_PLANES}"
        )
    if planes > 2 and (model is None or model.is_ideal):
        raise SceneError(
            f"journal {name!r}: planes = {planes} are of a journal with clearance; an ideal one is held by its two "
            "rims. Give Dry(...), or leave planes= out"
        )
    required = [positive("length", length, "m"), direction_requirement(numbers(axis))]
    if depth is not None:
        _depth_serves(name, model, depth)
        required += [r._replace(field=f"socket_depth.{r.field}") for r in depth.requirements()]
    enforce(f"journal {name!r}", required)
    return lobatto(int(planes))


def _depth_serves(name: str, model, depth) -> None:
    if not isinstance(depth, LegendreFourierDepth):
        raise SceneError(
            f"journal {name!r}: socket_depth is {type(depth).__name__}, and must be a depth by angle and place along "
            "the axis. Give sj.laws.LegendreFourierDepth(coefficients); one that is the same all along belongs to the "
            "model, Dry(..., socket_depth=sj.laws.FourierDepth(coefficients))"
        )
    if not hasattr(model, "socket_depth"):
        raise SceneError(
            f"journal {name!r}: socket_depth is of surfaces that touch, and its model is "
            f"{'Ideal' if model is None else type(model).__name__}. Give Dry(...): a film in a bearing that is not "
            "straight is not modelled"
        )
    if model.socket_depth is not None:
        raise SceneError(
            f"journal {name!r}: its model has a socket_depth, too; give the depth once, as the sum: the first row of "
            "LegendreFourierDepth is the same all along the axis"
        )
