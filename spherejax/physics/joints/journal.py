"""A journal in a bearing with clearance: a ball in a socket that feels nothing along the axis.

A journal that keeps parallel to its bearing has a guide of three equations, which hold its direction and its place
along the axis; across it the same laws, modes and landings answer as of a ball in its socket, in the plane. Without
the two that hold the direction it is the circle of a journal in a rim of its bearing; see `rim`.
"""

from typing import Any, ClassVar

import jax.numpy as jnp

from spherejax.foundations.rotation import conjugate, rotation_matrix
from spherejax.foundations.types import Matrix3, Scalar, Vector3
from spherejax.physics.joints.elementary import PlacedPair
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.kinematics import RelativeMotion

LARGEST_OVAL = 0.1
"""How oval the section of a journal that tilts may be, as a share of the clearance, without a word."""


class PlacedJournal(PlacedSpherical):
    """A journal in a bearing, in body axes.

    Attributes:
        bodies: names of the bearing's and the journal's body.
        socket_place: the bearing's center on its body, body axes [m].
        ball_place: the journal's center on its body, body axes [m].
        start_quaternion: journal's body against bearing's body at the start.
        model: how the joint resists.
        starts_concentric: whether the start is assembled as if the joint were ideal.
        frame: axes with z along the bearing in those of its body, as columns, shape (3, 3).
        ideal: the joint that this one is without clearance.
        guide: what holds the journal along the axis, and parallel to it; None for nothing.
    """

    is_ball: ClassVar[bool] = False

    guide: PlacedPair | None = None

    @property
    def n_rows(self) -> int:
        """Those of the guide: one along the axis, two of directions."""
        return 0 if self.guide is None else self.guide.n_rows

    def constraint_rows(self, t, motions):
        """What holds the journal along the axis and parallel to it."""
        return None if self.guide is None else self.guide.constraint_rows(t, motions)

    def assembly_rows(self, t, motions):
        """Those of the joint without clearance, unless the user placed the journal elsewhere."""
        start = self.as_if_ideal()
        return None if start is None else start.assembly_rows(t, motions)

    def as_if_ideal(self):
        """The joint without clearance; what guides the journal where that stays where the user placed it."""
        return self.ideal if self.starts_concentric else self.guide

    def across(self, motion: RelativeMotion) -> RelativeMotion:
        """The part of a motion across the bearing's axis, of the journal against the bearing *where its center is*:

            e' = e - s a,   e'_dot = e_dot - s w_i x a,   s = e . a

        so that e' . e'_dot is the rate of |e'|^2 / 2 however the axis a turns, and wherever along it the journal is.
        """
        axis, along = _along(motion)
        return motion._replace(
            eccentricity=motion.eccentricity - along * axis,
            eccentricity_rate=motion.eccentricity_rate - along * jnp.cross(motion.socket_angular_velocity, axis),
            ball_rotation=None if motion.ball_rotation is None else motion.ball_rotation @ self.frame_on_journal,
        )

    @property
    def frame_on_journal(self) -> Matrix3:
        """The joint's axes in those of the journal's body, as columns: at the start they are those of the bearing."""
        axes = rotation_matrix(conjugate(jnp.asarray(self.start_quaternion)))
        return axes if self.frame is None else axes @ self.frame

    def respond(self, motions, memory):
        """Force and moments at the centers; the bearing feels the force where the journal's center is."""
        motion = self.motion_of_centers(motions)
        response = self.model.respond(self.across(motion), memory)
        axis, along = _along(motion)
        moment = response.socket_moment - along * jnp.cross(axis, response.force)
        return response._replace(socket_moment=moment)

    @property
    def is_parallel(self) -> bool:
        """Whether the guide holds the journal's direction; a rim's does not (static)."""
        return self.guide is not None and bool(self.guide.right_angles)

    def share_of_tilt(self, motion: RelativeMotion) -> Scalar | None:
        """R (sin theta)^2 / 2, by which the journal's section is an oval, against a tenth of the clearance.

        None for a journal that is held parallel.
        """
        if self.is_parallel:
            return None
        model: Any = self.model
        x, y = motion.relative_quaternion[1], motion.relative_quaternion[2]
        half = x * x + y * y  # (sin (theta/2))^2, for z is the axis here
        return 2.0 * model.socket_radius * half * (1.0 - half) / (LARGEST_OVAL * model.clearance)


def _along(motion: RelativeMotion) -> tuple[Vector3, Scalar]:
    """The bearing's axis, and how far along it the journal's center is from the bearing's [m]."""
    axis = motion.socket_rotation[:, 2]
    return axis, motion.eccentricity @ axis
