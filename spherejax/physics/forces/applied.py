"""A force and a moment applied to a body."""

import inspect
from collections.abc import Callable, Mapping
from typing import Annotated, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import OWN, Named, Numeric, Triple, Unit, Vector3
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.forces.base import AbstractForce, FindPlace, Motions, Wrench, body_of, place_of
from spherejax.physics.functions.base import AbstractFunction, Given, nearest_breakpoint
from spherejax.physics.kinematics import PointMotion, point_motion


class AppliedWrench(AbstractForce):
    """A force at a point of a body, and a moment: constant, or functions of time, or of time and all motions.

    Attributes:
        body: name of the body, or `"body.point"`.
        force: world axes [N], shape (3,); or a function of time t [s], or of t and the motions of all bodies by name
            (`motions["body"].velocity`, see `spherejax.physics.kinematics.BodyMotion`), that returns it.
        moment: world axes [N m], shape (3,), or a function like `force`.
        place: where the force acts, body axes [m], shape (3,), from the named point, or from the center of mass.
        in_body_axes: whether force and moment are given in body axes and turn with the body.

    A function takes the motions if it has two arguments without default.

    Limits: a pulse of a function of one's own that is shorter than 1/20,000 of the motion can be passed over; declare
    it by the breaks of a `Piecewise`, where steps end: `sj.functions.Piecewise([0.4, 0.40001], [f, f, f])`.
    """

    body: str = eqx.field(static=True)
    force: Triple | Given
    moment: Triple | Given
    place: Triple
    in_body_axes: bool = eqx.field(static=True)

    def __init__(
        self,
        body: Annotated[str, Named.END],
        force: Annotated[Numeric, Unit("N"), OWN] = (0.0, 0.0, 0.0),
        moment: Annotated[Numeric, Unit("N m"), OWN] = (0.0, 0.0, 0.0),
        place: Annotated[Triple, Unit("m")] = (0.0, 0.0, 0.0),
        in_body_axes: bool = False,
    ):
        self.body = body
        self.force = Given(force) if callable(force) else numbers(force)
        self.moment = Given(moment) if callable(moment) else numbers(moment)
        self.place = numbers(place)
        self.in_body_axes = in_body_axes

    @property
    def body_names(self):
        """The one body."""
        return (body_of(self.body),)

    def placed(self, bodies: Mapping[str, Body], find: FindPlace) -> Self:
        """The place from the center of mass."""
        del bodies
        return eqx.tree_at(lambda force: force.place, self, self.place + place_of(self.body, find))

    def requirements(self):
        """Finite numbers."""
        given = [("force", self.force), ("moment", self.moment), ("place", self.place)]
        return [
            Requirement(name, value, abs(value) < np.inf, "be finite", "Check the units (SI).")
            for name, value in given
            if not isinstance(value, Given)
        ]

    def wrenches(self, t, motions):
        """The wrench about the center of mass."""
        force, moment, point = self._applied(t, motions)
        return {body_of(self.body): Wrench(force, moment + jnp.cross(point.arm, force))}

    def time_to_breakpoint(self, t, motions):
        """To where functions of one's own begin, end or turn, if they are `AbstractFunction`s and say so."""
        del motions
        given = [value.callable for value in (self.force, self.moment) if isinstance(value, Given)]
        return nearest_breakpoint(
            one.distance_to_breakpoint(t, True) for one in given if isinstance(one, AbstractFunction)
        )

    def unknown_in_time(self, t, motions):
        """Force and moment by functions of one's own that do not say where they turn."""
        given = [(value, unit) for value, unit in ((self.force, "N"), (self.moment, "N m")) if _is_unknown(value)]
        return tuple((_at(value, t, motions), unit) for value, unit in given)

    def parts(self, t, motions) -> dict[str, Array]:
        """`force` [N] and `moment` [N m], world axes, shape (3,)."""
        force, moment, _ = self._applied(t, motions)
        return {"force": force, "moment": moment}

    def _applied(self, t, motions: Motions) -> tuple[Vector3, Vector3, PointMotion]:
        motion = motions[body_of(self.body)]
        force, moment = _at(self.force, t, motions), _at(self.moment, t, motions)
        if self.in_body_axes:
            force, moment = motion.rotation @ force, motion.rotation @ moment
        return force, moment, point_motion(motion, jnp.asarray(self.place))


def _at(value: Numeric | Given, t, motions: Motions) -> Vector3:
    if not isinstance(value, Given):
        return jnp.asarray(value)
    return jnp.asarray(value(t, motions) if _takes_motions(value.callable) else value(t))


def _is_unknown(value: Numeric | Given) -> bool:
    if not isinstance(value, Given):
        return False
    function = value.callable
    return function.is_unknown if isinstance(function, AbstractFunction) else True


def _takes_motions(function: Callable) -> bool:
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    asked = inspect.signature(function).parameters.values()
    return sum(p.kind in kinds and p.default is inspect.Parameter.empty for p in asked) >= 2
