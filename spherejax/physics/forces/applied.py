"""A force and a moment applied to a body."""

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
    """

    body: str = eqx.field(static=True)
    force: Numeric
    moment: Numeric
    place: Numeric
    in_body_axes: bool = eqx.field(static=True)

    def __init__(
        self,
        body: str,
        force=(0.0, 0.0, 0.0),
        moment=(0.0, 0.0, 0.0),
        place=(0.0, 0.0, 0.0),
        in_body_axes: bool = False,
    ):
        self.body = body
        self.force = force if callable(force) else numbers(force)
        self.moment = moment if callable(moment) else numbers(moment)
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
            if not callable(value)
        ]

    def wrenches(self, t, motions):
        """The wrench about the center of mass."""
        motion = motions[self.body]
        force, moment = _at(self.force, t), _at(self.moment, t)
        if self.in_body_axes:
            force, moment = motion.rotation @ force, motion.rotation @ moment
        arm = point_motion(motion, jnp.asarray(self.place)).arm
        return {self.body: Wrench(force, moment + jnp.cross(arm, force))}


def _at(value: Numeric, t):
    return jnp.asarray(value(t) if callable(value) else value)
