"""The bushing: ball and socket joined by an elastomer, without clearance (sections 3.4 and 4.4)."""

from typing import Annotated

import jax.numpy as jnp

from spherejax.foundations.checks import Requirement
from spherejax.foundations.rotation import rotation_vector
from spherejax.foundations.types import Number, Unit
from spherejax.physics.joints.base import AbstractSphericalModel, Effect, Response
from spherejax.physics.laws import AbstractElastomer, RadialElastomer


class Bushing(AbstractSphericalModel):
    """Ball and socket joined by an elastomer.

    `Bushing(stiffness=k, damping=b)` is the paper's Eq. 41, f = k (delta + b delta_dot) n, with b in seconds. Other
    laws are given whole: `Bushing(law=VectorElastomer(...))`, `MatrixElastomer`, `CurveElastomer`, or a user's own.

    Attributes:
        law: how the elastomer resists.

    Args:
        stiffness: k of the paper's law, instead of `law` [N/m].
        damping: b of the paper's law, stiffness-proportional [s].

    The force acts on both bodies at the ball's center; rotations are counted from the start of the motion.
    """

    law: AbstractElastomer

    @property
    def never_adds_energy(self) -> bool:
        """Where its law does not."""
        return self.law.never_adds_energy

    def __init__(
        self,
        stiffness: Annotated[Number | None, Unit("N/m")] = None,
        damping: Annotated[Number | None, Unit("s")] = None,
        *,
        law: AbstractElastomer | None = None,
    ):
        if (law is None) == (stiffness is None):
            raise TypeError("give either stiffness= (and damping=) or law=, not both and not neither")
        if law is not None and damping is not None:
            raise TypeError("damping= belongs to stiffness=; a law= brings its own")
        if law is None:
            assert stiffness is not None
            law = RadialElastomer(stiffness, 0.0 if damping is None else damping)
        self.law = law

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The elastomer."""
        kind = "translation and rotation" if self.law.resists_rotation else "translation"
        return (Effect(f"elastomer, {kind} ({type(self.law).__name__})", self),)

    def requirements(self) -> list[Requirement]:
        """What the elastomer requires."""
        return self.law.requirements()

    def respond(self, motion, memory) -> Response:
        """Elastic and damping force and moment on the ball."""
        del memory
        e, socket = motion.eccentricity, motion.socket_rotation
        rate_on_socket = motion.eccentricity_rate - jnp.cross(motion.socket_angular_velocity, e)
        deflection, deflection_rate = e, rate_on_socket
        if not self.law.isotropic:
            deflection, deflection_rate = socket.T @ e, socket.T @ rate_on_socket
        force = self.law.force(deflection, deflection_rate)
        if not self.law.isotropic:
            force = socket @ force
        rotation, measure, moment = jnp.zeros(3), jnp.zeros(3), jnp.zeros(3)
        if self.law.resists_rotation:
            rotation = rotation_vector(motion.relative_quaternion)
            measure = self.law.measure_of_rotation(motion.relative_quaternion)
            relative = socket.T @ (motion.ball_angular_velocity - motion.socket_angular_velocity)
            moment = socket @ self.law.moment(measure, relative)
        return Response(
            force=force,
            ball_moment=moment,
            socket_moment=-jnp.cross(e, force) - moment,
            memory_rate=jnp.zeros(0),
            elastic_energy=self.law.elastic_energy(deflection, measure),
            parts={"deflection": deflection, "rotation": rotation},
        )
