"""What a model of a spherical joint is: how the ball's motion in its socket is answered."""

import abc
import enum
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from spherejax.foundations.checks import Requirement
from spherejax.foundations.types import Numeric, Scalar, Vector3
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.memory import MemoryEntry


class Response(NamedTuple):
    """How a joint answers a relative motion.

    Attributes:
        force: on the ball's body, at the ball's center, world axes [N]; the socket's body receives its opposite at
            the socket's center.
        ball_moment: on the ball's body about the ball's center, world axes [N m].
        socket_moment: on the socket's body about the socket's center, world axes [N m].
        memory_rate: time derivative of the joint's memory between events, shape (n_memory,).
        elastic_energy: energy that the joint stores [J].
        parts: named contributions for inspection, e.g. `penetration` [m], `normal_force` [N].
    """

    force: Vector3
    ball_moment: Vector3
    socket_moment: Vector3
    memory_rate: Float[Array, " n_memory"]
    elastic_energy: Scalar
    parts: dict[str, Array]


class Reaction(NamedTuple):
    """What a joint exerts on its second body (of a spherical joint: the ball's).

    Attributes:
        force: world axes [N].
        moment: about the joint's point on that body, world axes [N m].
    """

    force: Vector3
    moment: Vector3


PART_UNITS = {
    "penetration": "m",
    "normal_force": "N",
    "friction_force": "N",
    "film_force": "N",
    "film_moment": "N m",
    "film_power": "W",
    "shear_power": "W",
    "film_thickness": "m",
    "film_pressure": "Pa",
    "film_pressure_place": "1",
    "oil_temperature": "K",
    "hottest_oil": "K",
    "heat_to_socket": "W",
    "heat_to_ball": "W",
    "heat_to_flow": "W",
    "sliding_velocity": "m/s",
    "deflection": "m",
    "rotation": "rad",
    "friction_moment": "N m",
    "friction_power": "W",
    "bearing_load": "N",
    "friction_contraction": "1",
    "friction_remainder": "1",
    "branch_force": "N",
    "branch_moment": "N m",
}
"""Units of the named parts of a response; a part of a user's own model has none."""


SMALLEST_SQUARE = 1e-300
"""Of a distance [m^2]: keeps the root's derivative finite for a ball in the middle of its socket."""


class Crossing(NamedTuple):
    """A smooth function of time that changes sign when contact begins or ends.

    Attributes:
        value: g = (|p|^2 - 1) / 2 with p = e / c, dimensionless: -1/2 for a concentric ball, 0 at contact, and about
            penetration / clearance beyond. Unlike |e| - c it is smooth when the ball passes the socket's center.
        rate: its time derivative [1/s].
        velocity: p_dot [1/s], whose changes say how much the path in the socket bends.
    """

    value: Scalar
    rate: Scalar
    velocity: Vector3


class Effect(NamedTuple):
    """One physical effect of a model, for tables of what it costs.

    Attributes:
        name: what it is.
        model: the model with this effect and those listed before it, and without those listed after it.
    """

    name: str
    model: "AbstractSphericalModel"


class Medium(enum.Enum):
    """What lies between ball and socket, and acts wherever the ball is.

    Where `jax.jit` hides the numbers the method of integration is chosen by this: a film is usually too fast for
    explicit steps (1e4 to 1e6 per second), an elastomer is usually not, and a run on one may choose when it starts.
    """

    FILM = "a film"
    ELASTOMER = "an elastomer"

    @property
    def is_usually_fast(self) -> bool:
        """Whether explicit steps would be held by it."""
        return self is Medium.FILM


class AbstractSphericalModel(eqx.Module):
    """How a spherical joint resists: one of ideal, dry, lubricated, bushing, or a user's own.

    A model that is not ideal implements `respond`. A model with memory lists its entries in `memory`; a model whose
    contact begins and ends at sharp instants also implements `crossing`, `is_touching` and `memory_at_onset`.
    """

    is_ideal: ClassVar[bool] = False

    @property
    def memory(self) -> tuple[MemoryEntry, ...]:
        """What the model remembers (static); empty for a model without memory."""
        return ()

    @property
    def memory_fades(self) -> bool:
        """Whether what is remembered fades by itself, at rates that limit explicit steps (static)."""
        return bool(self.memory) and not self.detects_onsets

    @property
    def has_surfaces(self) -> bool:
        """Whether the ball has a `clearance` in its socket, and presses in what `surfaces` describes (static)."""
        return False

    @property
    def medium(self) -> Medium | None:
        """What lies between ball and socket (static); None where only constraints or contact act."""
        return None

    @property
    def stiffens_from_zero(self) -> bool:
        """Whether the contact force surely grows from a slope of zero: no derivative then jumps where contact ends."""
        return False

    @property
    def stiffens_abruptly(self) -> bool:
        """Whether the slope of the contact force by the depth may change at an unbounded rate where contact begins.

        So it does like depth^0.05 with an exponent of 1.05. Derivatives of runs by Rosenbrock methods are not right
        through such contacts. A model that says nothing is taken for one.
        """
        return not self.stiffens_from_zero

    @property
    def detects_onsets(self) -> bool:
        """Whether contact onsets and releases must be located (static)."""
        return False

    @property
    def never_adds_energy(self) -> bool:
        """Whether the joint only stores and dissipates, and reports all that it stores (static).

        Every run checks that the energy of the parts that say so rises by no more than all others put in, whose work
        is integrated beside the state.
        """
        return self.is_ideal

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The physical effects that the model brings in, one upon the other, for `sj.effects`."""
        return () if self.is_ideal else (Effect(type(self).__name__, self),)

    def relaxed(self, start: Numeric) -> Numeric:
        """Orientation of the ball's body against the socket's from which the model is told of rotations.

        Args:
            start: that in which the bodies are described, shape (4,).
        """
        return start

    @abc.abstractmethod
    def requirements(self) -> list[Requirement]:
        """What the model's numbers must satisfy."""

    def requirements_of(self, *, is_bearing: bool) -> list[Requirement]:
        """What the model's laws must be of: a ball in a socket, or a journal in a bearing."""
        del is_bearing
        return []

    def respond(self, motion: RelativeMotion, memory: Float[Array, " n_memory"]) -> Response:
        """Force and moment that answer a relative motion."""
        raise TypeError(f"{type(self).__name__} answers with constraints, not with a force")

    def rotation_share(self, motion: RelativeMotion) -> Scalar | None:
        """The rotation as a share of the largest that the model knows: a run ends beyond 1. None for any."""
        del motion
        return None

    def stored_energy(self, motion: RelativeMotion, memory: Float[Array, " n_memory"]) -> Scalar:
        """The `elastic_energy` of the response [J]; a model may have it without the rest."""
        return self.respond(motion, memory).elastic_energy

    def observed(self, motion: RelativeMotion, memory: Float[Array, " n_memory"]) -> dict[str, Array]:
        """More named parts beside those of the response: evaluated where someone looks, not at every step."""
        return {}

    def penetration(self, motion: RelativeMotion) -> Scalar | None:
        """Penetration |e| - c [m], negative without contact; None for a model without a socket surface."""
        return None

    def penetration_rate(self, motion: RelativeMotion) -> Scalar:
        """Its time derivative [m/s]: e . e_dot / |e|, where the socket is round."""
        e = motion.eccentricity
        return motion.eccentricity_rate @ e / jnp.sqrt(jnp.maximum(e @ e, SMALLEST_SQUARE))

    def crossing(self, motion: RelativeMotion) -> Crossing:
        """The function whose sign says whether there is contact."""
        raise TypeError(f"{type(self).__name__} has no contact")

    def is_touching(self, memory: Float[Array, " n_memory"]) -> Bool[Array, ""]:
        """Whether a contact has begun and not ended."""
        raise TypeError(f"{type(self).__name__} has no contact")

    def memory_at_onset(self, onset_rate: Scalar) -> Float[Array, " n_memory"]:
        """The memory just after a contact onset with the normal velocity `onset_rate` [m/s]."""
        raise TypeError(f"{type(self).__name__} has no contact")

    def memory_at_release(self) -> Float[Array, " n_memory"]:
        """The memory just after a release."""
        return jnp.zeros(len(self.memory))
