"""Quantities of a motion by name, e.g. `"acceleration.rocker"`: what tables, sweeps and fits ask for.

A name is a kind, and for most kinds a body or joint behind a dot. The kinds are methods and properties of
`Trajectory`.
"""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Scalar
from spherejax.model.system import System
from spherejax.motion.observables import Observation, observe
from spherejax.physics.state import unpack

AXIS, COMPONENT = ("axis",), ("component",)

Kinds = dict[str, tuple[tuple[str, ...], str]]

OF_BODIES: Kinds = {
    "position": (AXIS, "m"),
    "quaternion": (COMPONENT, "1"),
    "velocity": (AXIS, "m/s"),
    "angular_velocity": (AXIS, "rad/s"),
    "acceleration": (AXIS, "m/s^2"),
    "angular_acceleration": (AXIS, "rad/s^2"),
}
"""Kinds that belong to a body: dimensions behind time, unit."""

OF_JOINTS: Kinds = {
    "reaction": (AXIS, "N"),
    "reaction_moment": (AXIS, "N m"),
    "eccentricity": (AXIS, "m"),
    "eccentricity_rate": (AXIS, "m/s"),
    "penetration": ((), "m"),
    "absorbed_work": ((), "J"),
    "dissipated_energy": ((), "J"),
}
"""Kinds that belong to a joint."""

OF_THE_WHOLE: Kinds = {
    "kinetic_energy": ((), "J"),
    "potential_energy": ((), "J"),
    "elastic_energy": ((), "J"),
    "mechanical_energy": ((), "J"),
    "constraint_violation": ((), "m or 1"),
    "velocity_violation": ((), "m/s or 1/s"),
}
"""Kinds of the mechanism as a whole."""


@dataclass(frozen=True)
class Quantity:
    """A quantity by name.

    Attributes:
        kind: what it is.
        owner: the body or joint, or None.
        dims: dimensions behind time.
        unit: its unit.
    """

    kind: str
    owner: str | None
    dims: tuple[str, ...]
    unit: str

    @property
    def name(self) -> str:
        """As it was asked for."""
        return self.kind if self.owner is None else f"{self.kind}.{self.owner}"

    def of(self, run: Any) -> Array:
        """The quantity at the samples of a `Trajectory`, shape (n, ...)."""
        found = getattr(run, self.kind)
        return found if self.owner is None else found(self.owner)

    def needs_work(self) -> bool:
        """Whether the run must integrate the work of its joints."""
        return self.kind in ("absorbed_work", "dissipated_energy")


def quantity(name: str, system: System) -> Quantity:
    """A quantity of a system by name.

    Raises:
        SceneError: for an unknown kind, body or joint, naming those that exist.
    """
    kind, dot, owner = name.partition(".")
    for kinds, owners, what in ((OF_BODIES, system.bodies, "body"), (OF_JOINTS, system.joints, "joint")):
        if kind in kinds:
            if owner not in owners:
                raise SceneError(
                    f"{name!r}: {kind!r} belongs to a {what}; write '{kind}.NAME' with one of "
                    f"{', '.join(map(repr, owners))}"
                )
            return Quantity(kind, owner, *kinds[kind])
    if kind in OF_THE_WHOLE:
        if dot:
            raise SceneError(f"{name!r}: {kind!r} belongs to the mechanism as a whole; write {kind!r} alone")
        return Quantity(kind, None, *OF_THE_WHOLE[kind])
    known = ", ".join([*OF_BODIES, *OF_JOINTS, *OF_THE_WHOLE])
    raise SceneError(f"{name!r} names no quantity; the kinds are {known}")


def magnitudes(system: System, t: Scalar, y: Float[Array, " size"], names: tuple[str, ...]) -> Float[Array, " k"]:
    """Magnitudes of quantities at one state: norms of vectors, absolute values of numbers."""
    observation = observe(system, t, y)
    values = [_at_instant(system, observation, y, quantity(name, system)) for name in names]
    return jnp.stack([safe_norm(value) if value.ndim else jnp.abs(value) for value in values])


def _at_instant(system: System, observation: Observation, y, what: Quantity) -> Array:
    if what.kind in OF_BODIES:
        i = list(system.bodies).index(str(what.owner))
        state = unpack(system.layout, y)
        source = observation if what.kind.endswith("acceleration") else state
        return getattr(source, what.kind)[i]
    if what.kind in ("reaction", "reaction_moment"):
        reaction = observation.reactions[str(what.owner)]
        return reaction.force if what.kind == "reaction" else reaction.moment
    if what.kind in ("eccentricity", "eccentricity_rate"):
        return getattr(observation, what.kind)[str(what.owner)]
    if what.kind in ("kinetic_energy", "potential_energy", "constraint_violation", "velocity_violation"):
        return getattr(observation, what.kind)
    raise SceneError(f"the largest {what.name!r} of all steps cannot be kept; keep its samples instead")
