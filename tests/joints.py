"""Every kind of joint once, between two bodies in general position, and what it leaves free."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import spherejax as sj
from spherejax.foundations.rotation import rotation_matrix
from spherejax.model.system import flatten_system
from spherejax.motion.start.assembly import as_ideal, assemble_now

POINT = (0.1, -0.2, 0.3)
AXIS = (1.0, 2.0, -0.5)
ACROSS = (2.0, -1.0, 0.0)  # perpendicular to AXIS


class OnParabola(sj.joints.AbstractJoint):
    """A user's own joint, written as the documentation says: a point of the second body on a surface of the first."""

    bodies: tuple[str, str] = eqx.field(static=True)

    def joined(self, find):
        return self.bodies

    def requirements(self):
        return []

    def placed(self, bodies, find):
        return PlacedOnParabola(self.bodies)


class PlacedOnParabola(sj.joints.AbstractPlacedJoint):
    bodies: tuple[str, str] = eqx.field(static=True)

    @property
    def points(self):
        return np.zeros(3), np.zeros(3)

    @property
    def n_rows(self):
        return 1

    def constraint_rows(self, t, motions):
        def residual(t, first, second):
            x = first.rotation.T @ (second.position - first.position)
            return jnp.stack([x[2] - 0.5 * (x[0] ** 2 + x[1] ** 2) - 0.1])

        return sj.joints.differentiated_rows(residual, t, *(motions[name] for name in self.bodies), is_driven=False)


class Kind(NamedTuple):
    """A kind of joint.

    Attributes:
        build: the joint between bodies a and b.
        n_rows: its equations.
    """

    build: Callable
    n_rows: int


AB = ("a", "b")
KINDS = {
    "spherical": Kind(lambda: sj.Spherical("a.p", "b.p"), 3),
    "revolute": Kind(lambda: sj.Revolute(AB, POINT, AXIS), 5),
    "revolute at a named point": Kind(lambda: sj.Revolute(AB, "a.p", AXIS), 5),
    "universal": Kind(lambda: sj.Universal(AB, POINT, AXIS, ACROSS), 4),
    "cylindrical": Kind(lambda: sj.Cylindrical(AB, POINT, AXIS), 4),
    "rim": Kind(lambda: sj.joints.Rim(AB, POINT, AXIS), 2),
    "rim with a collar": Kind(lambda: sj.joints.Rim(AB, POINT, AXIS, is_thrust=True), 3),
    "prismatic": Kind(lambda: sj.Prismatic(AB, "b.p", AXIS), 5),
    "fixed": Kind(lambda: sj.Fixed(AB, POINT), 6),
    "point on plane": Kind(lambda: sj.joints.PointOnPlane("b.p", POINT, AXIS, body="a"), 1),
    "same orientation": Kind(lambda: sj.joints.SameOrientation(AB, POINT), 3),
    "parallel axes": Kind(lambda: sj.joints.ParallelAxes(AB, "b.p", AXIS), 2),
    "perpendicular axes": Kind(lambda: sj.joints.PerpendicularAxes(AB, POINT, AXIS, ACROSS), 1),
    "circle": Kind(lambda: sj.joints.PointOnCurve("b.p", sj.joints.Circle(POINT, AXIS, 0.3), body="a"), 2),
    "line": Kind(lambda: sj.joints.PointOnCurve("b.p", sj.joints.Line(POINT, AXIS), body="a"), 2),
    "implicit curve": Kind(
        lambda: sj.joints.PointOnCurve(
            "b.p", sj.joints.ImplicitCurve(lambda x: jnp.stack([x[2] - jnp.sin(3 * x[0]), x[1] - x[0] ** 2])), body="a"
        ),
        2,
    ),
    "distance": Kind(lambda: sj.joints.Distance("a.p", "b.p", 0.7), 1),
    "distance at the start": Kind(lambda: sj.joints.Distance("a.p", "b.q"), 1),
    "rotation driver": Kind(lambda: sj.RotationDriver(AB, AXIS, sj.functions.Sine(0.7, 0.3, 0.2, 0.1)), 1),
    "translation driver": Kind(lambda: sj.TranslationDriver(AB, "a.q", AXIS, sj.functions.Sine(0.1, 0.4, 0.3)), 1),
    "distance driver": Kind(lambda: sj.joints.DistanceDriver("a.p", "b.q", lambda t: 0.5 + 0.1 * jnp.tanh(t)), 1),
    "position driver": Kind(
        lambda: sj.joints.PositionDriver("b.p", lambda t: jnp.stack([0.1 * t, jnp.sin(t), jnp.cos(2 * t)]), body="a"), 3
    ),
    "one's own": Kind(lambda: OnParabola(AB), 1),
}


def pair(joint=None, **options) -> sj.Scene:
    """Two bodies in general position and motion; joined to each other or not at all."""
    rng = np.random.default_rng(7)

    def body(position):
        quaternion = rng.normal(size=4)
        return sj.Body(
            1.0 + rng.random(),
            0.02 + 0.01 * rng.random(3),
            position=position,
            quaternion=quaternion / np.linalg.norm(quaternion),
            velocity=0.3 * rng.normal(size=3),
            angular_velocity=rng.normal(size=3),
            points={"p": 0.2 * rng.normal(size=3), "q": 0.2 * rng.normal(size=3)},
        )

    bodies = {"a": body((0.0, 0.1, 0.2)), "b": body((0.3, -0.2, 0.4))}
    return sj.Scene(bodies, {} if joint is None else {"joint": joint}, **options)


def momenta(run):
    """Linear and angular momentum about the world's origin at all samples."""
    linear, angular = 0.0, 0.0
    for name, body in run.system.bodies.items():
        p = body.mass * np.asarray(run.velocity(name))
        R = np.asarray(jax.vmap(rotation_matrix)(run.quaternion(name)))
        w = np.asarray(run.angular_velocity(name))
        spin = np.einsum("nij,j,nkj,nk->ni", R, np.asarray(body.inertia), R, w)
        linear = linear + p
        angular = angular + np.cross(np.asarray(run.position(name)), p) + spin
    return linear, angular


def assembled(system: sj.equations.System) -> np.ndarray:
    """The flat state at the consistent start."""
    return np.asarray(assemble_now(*flatten_system(as_ideal(system))).y)
