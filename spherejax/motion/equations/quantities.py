"""Quantities of a motion by name, one language for sweeps, fits, sensitivities, designs, peaks and the command line.

    "acceleration.rocker", "reaction.elbow", "kinetic_energy"    a kind, and the body or joint that it is of
    "position.rocker.z"                                         one component of it
    "shock.length", "elbow.normal_force"                        a result of a force element, a part of a joint's answer

The kinds are methods and properties of `Trajectory`, results and parts those of `run.force` and `run.parts`.
"""

import difflib
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.numerics import safe_norm
from spherejax.foundations.types import Scalar
from spherejax.model.system import Structure, System, example_of, flatten_system
from spherejax.motion.equations.observables import Observation, looked_up, observe
from spherejax.physics.joints.base import PART_UNITS
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


LETTERS: dict[tuple[str, ...], str] = {AXIS: "xyz", COMPONENT: "wxyz"}
"""Components of a vector, and of a quaternion."""


@dataclass(frozen=True)
class Quantity:
    """A quantity by name.

    Attributes:
        kind: what it is; of a result or a part its name.
        owner: the body, joint or force element, or None.
        dims: dimensions behind time.
        unit: its unit; empty where it is not known.
        component: index of one component of a vector or quaternion, or None.
        of_element: whether it is a result of a force element.
        of_answer: whether it is a part of a joint's answer.
    """

    kind: str
    owner: str | None
    dims: tuple[str, ...]
    unit: str
    component: int | None = None
    of_element: bool = False
    of_answer: bool = False

    @property
    def name(self) -> str:
        """As it was asked for."""
        if self.of_element or self.of_answer:
            whole = f"{self.owner}.{self.kind}"
        else:
            whole = self.kind if self.owner is None else f"{self.kind}.{self.owner}"
        return whole if self.component is None else f"{whole}.{self.letters[self.component]}"

    @property
    def letters(self) -> str:
        """Names of the components of the whole."""
        return LETTERS[COMPONENT if self.kind == "quaternion" else AXIS]

    def of(self, run: Any) -> Array:
        """The quantity at the samples of a `Trajectory`, shape (n, ...)."""
        if self.of_element:
            found = run.force(self.owner)[self.kind]
        elif self.of_answer:
            found = run.part(self.owner, self.kind)
        else:
            found = getattr(run, self.kind)
            found = found if self.owner is None else found(self.owner)
        return found if self.component is None else found[..., self.component]

    def needs_work(self) -> bool:
        """Whether the run must integrate the work of its joints."""
        return self.kind in ("absorbed_work", "dissipated_energy")


def quantity(name: str, system: System) -> Quantity:
    """A quantity of a system by name.

    Raises:
        SceneError: for an unknown kind, body, joint or component, naming those that exist.
    """
    whole, _, letter = name.rpartition(".")
    found = _whole_quantity(name, system)
    if isinstance(found, Quantity):
        return found
    vector = _whole_quantity(whole, system) if whole else None
    if not isinstance(vector, Quantity) or vector.owner is None:
        raise SceneError(found)
    letters = LETTERS.get(vector.dims, "")
    if len(letter) != 1 or letter not in letters:
        known = ", ".join(f"'{whole}.{each}'" for each in letters) or "none"
        raise SceneError(f"{name!r}: {whole!r} has no component {letter!r}; its components are {known}")
    return replace(vector, dims=(), component=letters.index(letter))


def _whole_quantity(name: str, system: System) -> "Quantity | str":
    """The quantity with all its components; a sentence where there is none."""
    kind, dot, owner = name.partition(".")
    for kinds, owners, what in ((OF_BODIES, system.bodies, "body"), (OF_JOINTS, system.joints, "joint")):
        if kind in kinds:
            if owner not in owners:
                near = difflib.get_close_matches(owner, owners, n=1)
                meant = f"; did you mean '{kind}.{near[0]}'?" if near else ""
                return (
                    f"{name!r}: {kind!r} belongs to a {what}; write '{kind}.NAME' with one of "
                    f"{', '.join(map(repr, owners))}{meant}"
                )
            return Quantity(kind, owner, *kinds[kind])
    if kind in OF_THE_WHOLE:
        if dot:
            return f"{name!r}: {kind!r} belongs to the mechanism as a whole; write {kind!r} alone"
        return Quantity(kind, None, *OF_THE_WHOLE[kind])
    element, _, part = name.rpartition(".")
    if element in system.forces or element in system.resisting_joints:
        return _result(element, part, system)
    known = ", ".join([*OF_BODIES, *OF_JOINTS, *OF_THE_WHOLE])
    others = [*(f"{each}.NAME" for each in (*system.forces, *system.resisting_joints))]
    results = f", and results and parts {', '.join(others)}" if others else ""
    near = difflib.get_close_matches(kind, [*OF_BODIES, *OF_JOINTS, *OF_THE_WHOLE], n=1)
    meant = f"; did you mean {near[0]!r}?" if near else ""
    return f"{name!r} names no quantity; the kinds are {known}{results}{meant}"


def _result(element: str, part: str, system: System) -> "Quantity | str":
    """A result of a force element, or a part of a joint's answer."""
    of_element = element in system.forces
    shapes = _shapes_of(flatten_system(system)[0])[0 if of_element else 1][element]
    if part not in shapes:
        what = "result" if of_element else "part"
        return (
            f"'{element}.{part}': {element!r} has no {what} {part!r}; it has {', '.join(map(repr, shapes)) or 'none'}"
        )
    dims = {(): (), (3,): AXIS}.get(shapes[part])
    if dims is None:
        return f"'{element}.{part}' has the shape {shapes[part]}; numbers and vectors of three can be asked for by name"
    unit = (system.forces[element].part_units if of_element else PART_UNITS).get(part, "")
    return Quantity(part, element, dims, unit, of_element=of_element, of_answer=not of_element)


@lru_cache(maxsize=64)
def _shapes_of(structure: Structure) -> tuple[dict[str, dict], dict[str, dict]]:
    """Shapes of the results of force elements, and of the parts of joints' answers, by name."""

    def seen(t, y):
        system = example_of(structure)
        system = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), system)
        observation, more = observe(system, t, y), looked_up(system, y)
        return observation.forces, {name: found | more.get(name, {}) for name, found in observation.parts.items()}

    size = example_of(structure).layout.size
    shapes = jax.eval_shape(seen, jnp.zeros(()), jnp.zeros(size))
    return jax.tree.map(lambda x: x.shape, shapes)


def magnitudes(system: System, t: Scalar, y: Float[Array, " size"], names: tuple[str, ...]) -> Float[Array, " k"]:
    """Magnitudes of quantities at one state: norms of vectors, absolute values of numbers."""
    quantities = [quantity(name, system) for name in names]
    for what in quantities:
        if what.kind == "penetration":  # of a ball that flies it is negative, and its magnitude up to the clearance
            raise SceneError(
                f"the largest magnitude of {what.name!r} may be that of a ball that flies; run.impacts({what.owner!r}) "
                "has the peak_penetration of each contact"
            )
    observation = observe(system, t, y)
    values = [at_instant(system, observation, y, what) for what in quantities]
    return jnp.stack([safe_norm(value) if value.ndim else jnp.abs(value) for value in values])


@lru_cache(maxsize=64)
def values_of(names: tuple[str, ...]):
    """The values of quantities that are numbers, a function (system, t, y); one for the same names."""

    def values(system: System, t: Scalar, y: Float[Array, " size"]) -> Float[Array, " k"]:
        observation = observe(system, t, y)
        return jnp.stack([at_instant(system, observation, y, quantity(name, system)) for name in names])

    return values


def value_at(system: System, t: Scalar, y: Float[Array, " size"], name: str) -> Array:
    """A quantity at one state: a vector, or a number."""
    return at_instant(system, observe(system, t, y), y, quantity(name, system))


def at_instant(system: System, observation: Observation, y: Float[Array, " size"], what: Quantity) -> Array:
    """A quantity at one state, of which the observables are there already."""
    found = _whole_at_instant(system, observation, y, what)
    return found if what.component is None else found[what.component]


def _whole_at_instant(system: System, observation: Observation, y, what: Quantity) -> Array:
    if what.of_element:
        return observation.forces[str(what.owner)][what.kind]
    if what.of_answer:
        parts = observation.parts[str(what.owner)]
        return parts[what.kind] if what.kind in parts else looked_up(system, y)[str(what.owner)][what.kind]
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
    if what.kind == "penetration":
        model: Any = getattr(system.joints[str(what.owner)], "model", None)
        if getattr(model, "clearance", None) is None:
            raise SceneError(f"joint {what.owner!r} has no clearance: its model is {type(model).__name__}")
        if model.has_surfaces and not model.surfaces.are_round:
            return observation.parts[str(what.owner)]["penetration"]
        return safe_norm(observation.eccentricity[str(what.owner)]) - model.clearance
    if what.kind in ("elastic_energy", "mechanical_energy"):
        elastic = sum(observation.elastic_energy.values(), jnp.zeros(()))
        if what.kind == "elastic_energy":
            return elastic
        return observation.kinetic_energy + observation.potential_energy + elastic
    raise SceneError(f"{what.name!r} adds up from the start of a run: it is known at its samples alone")
