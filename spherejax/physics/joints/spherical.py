"""The spherical joint: a ball in a socket, ideal or with a model of how they resist."""

from typing import Annotated, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.checks import Requirement, called
from spherejax.foundations.rotation import conjugate, quaternion_product
from spherejax.foundations.types import Named, Numeric, Scalar
from spherejax.physics.joints.base import AbstractSphericalModel, Response
from spherejax.physics.joints.body_axes import relative_start
from spherejax.physics.joints.ideal import Ideal
from spherejax.physics.joints.joint import AbstractJoint, AbstractPlacedJoint, Motions
from spherejax.physics.joints.reaction_friction import BallFriction, friction_requirements
from spherejax.physics.joints.rows import ConstraintRows, coincidence_rows
from spherejax.physics.kinematics import PointMotion, RelativeMotion, point_motion
from spherejax.physics.memory import MemoryEntry


class Spherical(AbstractJoint):
    """A ball in a socket, with a model of how they resist.

    Attributes:
        socket: `"body.point"` of the socket's center (body i).
        ball: `"body.point"` of the ball's center (body j).
        model: `Ideal()`, `Dry(...)`, `Lubricated(...)`, `Bushing(...)`.
        starts_concentric: whether the start is assembled so that the two centers coincide and move together, as if
            the joint were ideal; False leaves the ball where the bodies' initial positions put it.
    """

    socket: Annotated[str, Named.POINT] = eqx.field(static=True)
    ball: Annotated[str, Named.POINT] = eqx.field(static=True)
    model: AbstractSphericalModel = eqx.field(default_factory=Ideal)
    starts_concentric: bool = eqx.field(static=True, default=True)

    def as_described(self):
        """The joint with a ball that starts where the bodies put it."""
        return Spherical(self.socket, self.ball, self.model, starts_concentric=False)

    def requirements(self) -> list[Requirement]:
        """What the model requires, and that it is one of a ball in a socket."""
        of_ball = type(self.model).requirements_of(self.model, is_bearing=False)
        required = [*called(self.model, "requirements"), *of_ball]
        if isinstance(self.model, Ideal):
            required = [*required, *friction_requirements(self.model, turns=True, slides=False, is_ball=True)]
        return required

    def joined(self, find):
        """The bodies of socket and ball."""
        return find(self.socket)[0], find(self.ball)[0]

    def placed(self, bodies, find):
        """The centers in body axes, and the relative orientation at the start."""
        (socket_body, socket_place), (ball_body, ball_place) = find(self.socket), find(self.ball)
        start = relative_start(bodies, socket_body, ball_body)
        return PlacedSpherical(
            (socket_body, ball_body), socket_place, ball_place, start, self.model, self.starts_concentric
        )


class PlacedSpherical(AbstractPlacedJoint):
    """A ball in a socket, in body axes.

    Attributes:
        bodies: names of the socket's and the ball's body.
        socket_place: socket center on its body, body axes [m].
        ball_place: ball center on its body, body axes [m].
        start_quaternion: ball's body against socket's body at the start.
        model: how the joint resists.
        starts_concentric: whether the start is assembled as if the joint were ideal.
        frame: socket axes in those of its body, as columns, shape (3, 3); None: they are the same.
        ideal: the joint that this one is with an ideal model, where that is not spherical.
        is_ball: whether its surfaces are those of a ball in a socket, and not of a journal in a bearing (static).
    """

    is_ball: ClassVar[bool] = True

    bodies: tuple[str, str] = eqx.field(static=True)
    socket_place: Numeric
    ball_place: Numeric
    start_quaternion: Numeric
    model: AbstractSphericalModel
    starts_concentric: bool = eqx.field(static=True)
    frame: Numeric | None = None
    ideal: AbstractPlacedJoint | None = None

    @property
    def is_parallel(self) -> bool:
        """Whether a journal is held parallel to its bearing; a ball needs no such thing (static)."""
        return True

    @property
    def points(self) -> tuple[Numeric, Numeric]:
        """The centers of socket and ball, on their bodies."""
        return self.socket_place, self.ball_place

    @property
    def n_rows(self) -> int:
        """Three for an ideal joint, none for the others."""
        return 3 if self.model.is_ideal else 0

    @property
    def answers_with_force(self) -> bool:
        """Whether the model is not ideal."""
        return not self.model.is_ideal

    @property
    def friction(self) -> BallFriction | None:
        """Friction of the ideal joint, where its model has some."""
        model = self.model
        return BallFriction(model) if isinstance(model, Ideal) and model.friction is not None else None

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """That of the model, or of its friction."""
        return self.model.memory if self.friction is None else self.friction.memory

    @property
    def never_adds_energy(self) -> bool:
        """As the model."""
        return self.model.never_adds_energy

    def constraint_rows(self, t, motions):
        """Three equations for an ideal joint, none for the others."""
        del t
        return self.coincidence(motions) if self.model.is_ideal else None

    def assembly_rows(self, t, motions):
        """The centers coincide at the start, unless the user placed the ball elsewhere."""
        if not (self.model.is_ideal or self.starts_concentric):
            return None
        return self.coincidence(motions) if self.ideal is None else self.ideal.assembly_rows(t, motions)

    def as_if_ideal(self):
        """The ideal joint; None where the ball stays where the user placed it."""
        if self.model.is_ideal:
            return self if self.friction is None else eqx.tree_at(lambda joint: joint.model, self, Ideal())
        if not self.starts_concentric:
            return None
        return self.ideal if self.ideal is not None else eqx.tree_at(lambda joint: joint.model, self, Ideal())

    def coincidence(self, motions: Motions) -> ConstraintRows:
        """The equations of the ideal joint, whatever the model."""
        socket, ball = self.bodies
        return coincidence_rows(motions[socket], motions[ball], self.socket_place, self.ball_place)

    def centers(self, motions: Motions) -> tuple[PointMotion, PointMotion]:
        """Motion of the socket's and of the ball's center."""
        socket, ball = self.bodies
        return point_motion(motions[socket], self.socket_place), point_motion(motions[ball], self.ball_place)

    def relative_motion(self, motions: Motions) -> RelativeMotion:
        """What the model is told of the motion of the ball in the socket."""
        return self.across(self.motion_of_centers(motions))

    def across(self, motion: RelativeMotion) -> RelativeMotion:
        """The part of a motion that the model answers: all of it for a ball."""
        return motion

    def share_of_tilt(self, motion: RelativeMotion) -> Scalar | None:
        """How far a journal tilts in its bearing, as a share of what the joint is for; None for any."""
        del motion
        return None

    def motion_of_centers(self, motions: Motions) -> RelativeMotion:
        """Motion of the ball's center against the socket's (Eqs 12 to 14)."""
        socket, ball = motions[self.bodies[0]], motions[self.bodies[1]]
        socket_center, ball_center = self.centers(motions)
        now = quaternion_product(conjugate(socket.quaternion), ball.quaternion)
        # Turned back by the start, in socket axes: zero rotation there whatever the bodies' axes are.
        relative = quaternion_product(now, conjugate(self.model.relaxed(self.start_quaternion)))
        axes = socket.rotation
        if self.frame is not None:
            axes = axes @ self.frame
            relative = jnp.concatenate([relative[:1], jnp.asarray(self.frame).T @ relative[1:]])
        return RelativeMotion(
            ball_center.position - socket_center.position,
            ball_center.velocity - socket_center.velocity,
            axes,
            relative,
            socket.angular_velocity,
            ball.angular_velocity,
            ball.rotation,
        )

    def respond(self, motions: Motions, memory: Float[Array, " n_memory"]) -> Response:
        """Force and moments at the centers."""
        return self.model.respond(self.relative_motion(motions), memory)
