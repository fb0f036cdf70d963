"""A force and a moment applied to a body."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Numeric
from spherejax.physics.bodies import numbers
from spherejax.physics.forces.base import AbstractForce, Wrench
from spherejax.physics.kinematics import point_motion


class AppliedWrench(AbstractForce):
    """A force at a point of a body, and a moment, constant or functions of time.

    Attributes:
        body: name of the body.
        force: world axes [N], shape (3,), or a function of time t [s] that returns it.
        moment: world axes [N m], shape (3,), or a function of time.
        place: where the force acts, body axes [m], shape (3,); the center of mass by default.
        in_body_axes: whether force and moment are given in body axes and turn with the body.
        functions: the functions of time, where force or moment is one (then the number is None).
    """

    body: str = eqx.field(static=True)
    force: Numeric
    moment: Numeric
    place: Numeric
    in_body_axes: bool = eqx.field(static=True)
    functions: tuple[Callable | None, Callable | None] = eqx.field(static=True)

    def __init__(
        self,
        body: str,
        force=(0.0, 0.0, 0.0),
        moment=(0.0, 0.0, 0.0),
        place=(0.0, 0.0, 0.0),
        in_body_axes: bool = False,
    ):
        self.body = body
        # A function is structure, not a number: two scenes with different functions are different programs.
        self.functions = (force if callable(force) else None, moment if callable(moment) else None)
        self.force = None if callable(force) else numbers(force)
        self.moment = None if callable(moment) else numbers(moment)
        self.place = numbers(place)
        self.in_body_axes = in_body_axes

    @property
    def body_names(self):
        """The one body."""
        return (self.body,)

    def requirements(self):
        """Finite numbers."""
        given = [("force", self.force), ("moment", self.moment), ("place", self.place)]
        return [
            Requirement(name, value, abs(value) < np.inf, "be finite", "Check the units (SI).")
            for name, value in given
            if value is not None
        ]

    def wrenches(self, t, motions):
        """The wrench about the center of mass."""
        motion = motions[self.body]
        force, moment = _at(self.force, self.functions[0], t), _at(self.moment, self.functions[1], t)
        if self.in_body_axes:
            force, moment = motion.rotation @ force, motion.rotation @ moment
        arm = point_motion(motion, jnp.asarray(self.place)).arm
        return {self.body: Wrench(force, moment + jnp.cross(arm, force))}


def _at(value: Numeric, function: Callable | None, t):
    return jnp.asarray(value if function is None else function(t))
