"""From a scene to a system: only what the scene calls for, in a form ready for the equations of motion."""

import itertools
import math
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.checks import called, is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.linear_algebra import REDUNDANT_PIVOT, SINGULAR_PIVOT
from spherejax.foundations.types import Numeric
from spherejax.model.drift import AbstractDriftControl
from spherejax.model.scene import N_PARTS, Scene, check_scene
from spherejax.physics.bodies import Body, numbers
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.remembering import (
    AbstractForceWithMemory,
    ActingForce,
    is_sampled,
    memory_entries,
    recalling,
)
from spherejax.physics.joints.joint import AbstractPlacedJoint
from spherejax.physics.joints.spherical import PlacedSpherical
from spherejax.physics.laws.normal import AbstractNormalLaw, by_factor
from spherejax.physics.memory import MemoryEntry
from spherejax.physics.orientations import as_quaternion
from spherejax.physics.state import Layout
from spherejax.program_cache.keys import LruCache, lru_get, own_arrays, value_key
from spherejax.program_cache.user_code import user_code_fingerprint


class MemorySlot(NamedTuple):
    """Where the memory of one joint or force element is (static).

    Attributes:
        joint: name of the joint, or of the force element.
        start: index of its first entry in the memory.
        contents: what the entries are.
    """

    joint: str
    start: int
    contents: tuple[MemoryEntry, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries."""
        return tuple(entry.name for entry in self.contents)

    @property
    def entries(self) -> slice:
        """Its entries in the memory."""
        return slice(self.start, self.start + len(self.contents))


class System(eqx.Module):
    """A compiled scene: a pytree whose leaves are the physical numbers and whose structure is static.

    Attributes:
        bodies: moving bodies by name, sorted: the order of the state.
        joints: placed joints by name.
        forces: force elements by name.
        gravity: world axes [m/s^2].
        drift: drift control.
        memory_slots: where the joints' memory is; empty where no law needs one.
        tracks_work: whether the state carries the work that each joint with a force or friction absorbs.
        tracks_supply: whether the state carries the work put in by parts that may add energy: drivers, applied forces,
            roads that move, bristles, parts of a user's own.
        conserves_energy: whether each part conserves energy, or has its work integrated beside the state: then the
            energy, less what was put in, is constant.
        refines_constraints: whether the constraint equations are solved in two passes, for masses far apart.
        smallest_pivot: from where on a constraint equation counts as dependent on others; see `symmetric_solve`.
        force_slots: where the memory of force elements is, behind that of the joints; empty where none has one.
        stacks: the numbers of bodies and joints as `model.groups.Stacks`, where they have been stacked already (once,
            ahead of a loop); None otherwise.
    """

    bodies: dict[str, Body]
    joints: dict[str, AbstractPlacedJoint]
    forces: dict[str, AbstractForce]
    gravity: Numeric
    drift: AbstractDriftControl
    memory_slots: tuple[MemorySlot, ...] = eqx.field(static=True)
    tracks_work: bool = eqx.field(static=True)
    tracks_supply: bool = eqx.field(static=True, default=False)
    conserves_energy: bool = eqx.field(static=True, default=True)
    refines_constraints: bool = eqx.field(static=True, default=False)
    smallest_pivot: float = eqx.field(static=True, default=REDUNDANT_PIVOT)
    force_slots: tuple[MemorySlot, ...] = eqx.field(static=True, default=())
    stacks: Any = None

    @property
    def layout(self) -> Layout:
        """Where things are in the flat state."""
        n_memory = sum(len(slot.contents) for slot in self.all_slots)
        n_work = (len(self.resisting_joints) if self.tracks_work else 0) + self.tracks_constraint_work
        n_work += self.tracks_supply
        return Layout(len(self.bodies), n_memory, n_work)

    @property
    def tracks_constraint_work(self) -> bool:
        """Whether the state carries the work of the constraint forces, which is zero in an exact motion (static).

        Only where parts dissipate: elsewhere the energy itself tells what these forces have taken.
        """
        return not self.conserves_energy and any(joint.n_rows for joint in self.joints.values())

    @property
    def constraint_work_index(self) -> int:
        """Where that work is among the entries of the work: before the work that is put in, which is last (static)."""
        return -1 - self.tracks_supply

    @property
    def all_slots(self) -> tuple[MemorySlot, ...]:
        """Where the memory of joints is, then that of force elements."""
        return (*self.memory_slots, *self.force_slots)

    @property
    def sampled_forces(self) -> tuple[str, ...]:
        """Names of the force elements that sample: their memory jumps at instants of their own."""
        return tuple(slot.joint for slot in self.force_slots if is_sampled(self.forces[slot.joint]))

    @property
    def force_states(self) -> tuple[MemorySlot, ...]:
        """Where force elements remember more than how often their angles went round."""
        return tuple(slot for slot in self.force_slots if not all(entry.counts_turns for entry in slot.contents))

    def forces_with(self, memory: Float[Array, " n_memory"]) -> Mapping[str, ActingForce]:
        """The force elements, each with its entries of the state.

        Elements that count turns have entries though they do not remember; a controller without integral and filter
        is an element that remembers, though it has none.
        """
        entries = {slot.joint: slot.entries for slot in self.force_slots}
        recall = [n for n, force in self.forces.items() if n in entries or isinstance(force, AbstractForceWithMemory)]
        if not recall:
            return self.forces
        known = {name: recalling(self.forces[name], memory[entries.get(name, slice(0, 0))]) for name in recall}
        return {name: known.get(name, force) for name, force in self.forces.items()}

    @property
    def force_joints(self) -> tuple[str, ...]:
        """Names of the joints that answer with a force."""
        return tuple(name for name, joint in self.joints.items() if joint.answers_with_force)

    @property
    def friction_joints(self) -> tuple[str, ...]:
        """Names of the ideal joints with friction."""
        return tuple(name for name, joint in self.joints.items() if joint.friction is not None)

    @property
    def friction_passes(self) -> int:
        """Passes in which friction by reactions is found; none where no friction depends on a reaction (static)."""
        models = [joint.friction.model for joint in self.joints.values() if joint.friction is not None]
        return max((model.passes for model in models if model.follows_reaction), default=0)

    @property
    def resisting_joints(self) -> tuple[str, ...]:
        """Names of the joints that take power from the bodies: those that answer with a force, or have friction."""
        return tuple(
            name for name, joint in self.joints.items() if joint.answers_with_force or joint.friction is not None
        )

    @property
    def contact_joints(self) -> tuple[str, ...]:
        """Names of the joints whose contact onsets must be located."""
        return tuple(name for name in self.force_joints if called(self, "spherical", name).model.detects_onsets)

    @property
    def touching_forces(self) -> tuple[str, ...]:
        """Names of the force elements that press from one side, whose touches must be located."""
        return tuple(name for name, force in self.forces.items() if force.n_touches)

    def spherical(self, name: str) -> PlacedSpherical:
        """A joint that is known to be spherical."""
        joint = self.joints[name]
        assert isinstance(joint, PlacedSpherical), name
        return joint

    @property
    def n_constraints(self) -> int:
        """Number of constraint equations."""
        return sum(joint.n_rows for joint in self.joints.values())

    @property
    def is_driven(self) -> bool:
        """Whether a joint prescribes a motion as a function of time."""
        return any(joint.is_driven for joint in self.joints.values())

    def memory_of(self, joint: str) -> slice:
        """The joint's entries in the memory; an empty slice without memory."""
        for slot in self.memory_slots:
            if slot.joint == joint:
                return slot.entries
        return slice(0, 0)


class CompiledScene(NamedTuple):
    """A compiled scene and the conditions that could not be judged yet.

    Attributes:
        system: the system.
        conditions: boolean scalars on traced values; a lane in which one fails is not simulated.
    """

    system: System
    conditions: list


def compile_scene(scene: Scene, *, track_work: bool = False) -> CompiledScene:
    """Check a scene and reduce it to the effects that it calls for.

    Constraint rows exist for ideal joints only; contact, friction, film and elastomer only in joints whose model has
    them; memory only for laws that use it; work only when asked for.

    Args:
        scene: the scene.
        track_work: integrate the work that each non-ideal joint absorbs, for an exact account of dissipation.

    Raises:
        SceneError: for a scene that cannot be simulated.
    """
    conditions = check_scene(scene)
    # JAX sorts the keys of a dict when it takes it apart: a system is sorted from the start, so that the order of the
    # state is the same inside and outside a compiled program.
    bodies = {name: _known("body", scene.bodies[name], (), moving_body) for name in sorted(scene.bodies)}
    place = placing(scene)
    joints = {name: place("joint", name, scene.joints[name]) for name in sorted(scene.joints)}
    forces = {name: place("force", name, scene.forces[name]) for name in sorted(scene.forces)}
    slots = _slots({name: joint.memory for name, joint in joints.items()}, 0)
    force_slots = _slots({name: memory_entries(force) for name, force in forces.items()}, _end_of(slots))
    # A driver that pushes a mechanism beyond its reach must stop the run, not be left out.
    refines, smallest = for_masses(bodies, any(joint.is_driven for joint in joints.values()))
    parts = (*joints.values(), *forces.values())
    gains = not all(part.never_adds_energy for part in parts)
    # The whole work of a part that may add energy is integrated beside the state, what it dissipates included.
    conserves = all(part.conserves_energy or not part.never_adds_energy for part in parts)
    system = System(
        bodies,
        joints,
        forces,
        scene.gravity,
        scene.drift,
        slots,
        track_work,
        gains,
        conserves,
        refines,
        smallest,
        force_slots,
    )
    twice = {slot.joint for slot in slots} & {slot.joint for slot in system.force_states}
    if twice:
        raise SceneError(f"a joint and a force element that both remember are named {min(twice)!r}; rename one of them")
    return CompiledScene(system, conditions)


def _slots(entries: dict[str, tuple[MemoryEntry, ...]], start: int) -> tuple[MemorySlot, ...]:
    """Where the memory of parts is, one after the other; none of a part without memory."""
    slots = []
    for name, contents in entries.items():
        if contents:
            slots.append(MemorySlot(name, start, contents))
            start += len(contents)
    return tuple(slots)


def _end_of(slots: tuple[MemorySlot, ...]) -> int:
    return slots[-1].entries.stop if slots else 0


class BodyGeometry(NamedTuple):
    """A body as the parts of this package are placed by it: without its mass, for to place them anew whenever a mass
    is another one takes longer than all else that is made of that number.

    Attributes:
        position: world axes [m].
        quaternion: body axes to world axes.
        points: by name, body axes [m].
    """

    position: Numeric
    quaternion: Numeric
    points: Mapping[str, Numeric]

    @classmethod
    def of(cls, body: Body) -> "BodyGeometry":
        """A body where joints and forces are described; as `Body.in_reference`."""
        position, quaternion = body.reference_position, body.reference_quaternion
        return cls(
            numbers(body.position if position is None else position),
            numbers(as_quaternion(body.quaternion if quaternion is None else quaternion)),
            {name: numbers(place) for name, place in body.points.items()},
        )


@lru_cache(maxsize=N_PARTS)
def is_own(structure: Any) -> bool:
    """Whether a part, by its tree structure, is made of classes of this package alone, and of containers."""
    node = structure.node_data()
    if node is None:  # a number
        return True
    kind = node[0]
    own = kind in (dict, list, tuple, type(None)) or kind.__module__.partition(".")[0] == __name__.partition(".")[0]
    return own and all(map(is_own, structure.children()))


def placing(scene: Scene) -> Callable[[str, str, Any], Any]:
    """A function that places joints and force elements between the bodies of a scene.

    Those that were placed before, between bodies as they are drawn, are not placed again: who changes one number of one
    joint, or a mass, and runs the scene anew need not wait for all the others. Parts of a user's own may look at all
    that there is to a body.
    """
    find = partial(called, scene, "find")
    drawn = {name: BodyGeometry.of(body) for name, body in scene.bodies.items()}
    are_own = all(type(body) is Body for body in scene.bodies.values())
    around = cache(lambda: value_key((drawn, scene.ground_points)))
    around_all = cache(lambda: value_key((scene.bodies, scene.ground_points)))
    whole = cache(lambda: {name: _known("drawn", each, (), _in_reference) for name, each in scene.bodies.items()})

    def place(kind: str, name: str, part: Any) -> Any:
        sees_all = not (are_own and is_own(jax.tree.structure(part)))

        def placed(part: Any) -> Any:
            made = called(part, "placed", whole() if sees_all else drawn, find)
            check_leaves(f"{kind} {name!r}", made)
            return made

        return _known(kind, part, around_all() if sees_all else around(), placed)

    return place


def _in_reference(body: Body) -> Body:
    return body.in_reference


def _known(what: str, part: Any, around: Hashable | None, make: Callable[[Any], Any]) -> Any:
    """What is made of a part, remembered by the values of the part and of what else it is made of.

    None in place of these: they cannot be compared. What is handed out has arrays of its own, in which a user may write
    as in those of the scene.
    """
    values = value_key(part)
    if values is None or around is None:
        return make(part)
    key = what, values, around
    return own_arrays(lru_get(_parts, key, lambda: own_arrays(make(part))))


_parts = LruCache(N_PARTS)
"""What was made of parts of scenes."""


def check_leaves(place: str, part: Any) -> None:
    """Parts that a user has written hold numbers; names and functions are structure."""
    for leaf in jax.tree.leaves(part):
        if isinstance(leaf, str) or callable(leaf):
            raise SceneError(
                f"{place} ({type(part).__name__}) holds {leaf!r} among its numbers; declare names and functions "
                "with equinox.field(static=True), or wrap a network: sj.Network(module)"
            )
        if jnp.iscomplexobj(leaf):
            raise SceneError(
                f"{place} ({type(part).__name__}) holds complex numbers; a scene has real ones. Give real and "
                "imaginary parts, or wrap the module that holds them: sj.Network(module)"
            )


LARGE_MASS_RATIO = 1e4
"""From this ratio of masses on, rounding in the constraint forces disturbs the light body; of moments likewise."""


def _masses_are_far_apart(bodies: Mapping[str, Body]) -> bool:
    """Whether masses differ so much, or may, being traced."""
    return _are_far_apart([body.mass for body in bodies.values()])


def _smallest_pivot(bodies: Mapping[str, Body]) -> float:
    """The bound of a singular configuration, where no difference of masses or moments makes pivots as small."""
    alike = not _masses_are_far_apart(bodies) and not _are_far_apart([_moments(body) for body in bodies.values()])
    return SINGULAR_PIVOT if alike else REDUNDANT_PIVOT


def for_masses(bodies: Mapping[str, Body], is_driven: bool) -> tuple[bool, float]:
    """Whether masses and moments ask for two passes of the constraint equations, and from where on these count as
    dependent; see `System`."""
    return _masses_are_far_apart(bodies), REDUNDANT_PIVOT if is_driven else _smallest_pivot(bodies)


def _moments(body: Body) -> Numeric:
    return body.inertia if np.ndim(body.inertia) == 1 else body.inertia.diagonal()


def _are_far_apart(values: list) -> bool:
    if not all(is_concrete(value) for value in values):
        return True
    numbers = [number for value in values for number in np.asarray(value).ravel().tolist()]
    return max(numbers) > LARGE_MASS_RATIO * min(numbers)


def moving_body(body: Body) -> Body:
    """A body as the equations of motion see it."""
    # Points are resolved into the joints; leaving them here would make unused numbers part of the program's shape.
    return Body(body.mass, body.inertia, body.position, body.quaternion, body.velocity, body.angular_velocity)


SPECIAL_VALUES = (0.0, 1.0, -1.0, 1.5)
"""Numbers that simplify the program when they are known: structural zeros and ones, and the Hertzian exponent."""


def code_now(tree: Any) -> str:
    """Fingerprint of code of a user's own in the tree structure of a system, as that code is now; empty without."""
    return user_code_fingerprint(tree)


@dataclass(frozen=True)
class Structure:
    """Everything static about a system: what a program is compiled for. Hashable; no pytree.

    Attributes:
        tree: the tree structure of the system's leaves.
        shapes: the leaves' shapes.
        special: entries that are known to be one of `SPECIAL_VALUES`, as (flat index, value).
        code: fingerprint of code of a user's own in it, as it was when it was found; empty without.
    """

    tree: Any
    shapes: tuple[tuple[int, ...], ...]
    special: tuple[tuple[int, float], ...]
    code: str = ""

    @cached_property
    def _hash(self) -> int:
        return hash((self.tree, self.shapes, self.special, self.code))

    @cached_property
    def starts(self) -> list[int]:
        """Where the numbers of each leaf begin, and where the last ones end."""
        return [0, *itertools.accumulate(map(math.prod, self.shapes))]

    def for_special(self, special: tuple[tuple[int, float], ...]) -> "Structure":
        """That of a system of the same tree and shapes; itself where the same numbers are special."""
        return self if special == self.special else replace(self, special=special)

    def __hash__(self) -> int:
        return self._hash

    def system(self, theta) -> System:
        """The system whose numbers are the flat vector `theta`."""
        if is_concrete(theta):
            ends = zip(self.starts, self.starts[1:], self.shapes, strict=False)
            leaves = [theta[start:end].reshape(shape) for start, end, shape in ends]
        else:
            # One operation for all leaves: of a hundred bodies there are two thousand, and each costs 0.1 ms to trace.
            parts = jax.lax.split(theta, [math.prod(shape) for shape in self.shapes]) if self.shapes else []
            leaves = [part.reshape(shape) for part, shape in zip(parts, self.shapes, strict=True)]
        return jax.tree.unflatten(self.tree, leaves)


def flatten_system(system: System):
    """Split a system into its static `Structure` and the flat vector of its numbers.

    Returns:
        structure, theta: `theta` has shape (p,); NumPy when everything is concrete, else a (traced) JAX array.
    """

    leaves, tree = jax.tree.flatten(system)
    return structure_and_numbers(leaves, tree)


def special_in(numbers: Float[np.ndarray, " n"]) -> list[tuple[int, float]]:
    """Which numbers are one of `SPECIAL_VALUES`, as (index, value)."""
    at = np.flatnonzero((numbers[:, None] == _SPECIAL).any(axis=1))
    return list(zip(at.tolist(), numbers[at].tolist(), strict=True))


_SPECIAL = np.array(SPECIAL_VALUES)


def structure_and_numbers(leaves: list, tree: Any):
    """`flatten_system` of a system that is taken apart already."""
    shapes = tuple(np.shape(leaf) for leaf in leaves)
    # What is concrete is joined by NumPy: to JAX each shape would be a program to compile.
    parts: list[Any] = []
    special, start = [], 0
    for known, group in itertools.groupby(leaves, is_concrete):
        some = list(group)
        if known:
            flat = np.concatenate([np.asarray(leaf, np.float64).ravel() for leaf in some])
            special += [(start + i, value) for i, value in special_in(flat)]
            parts.append(flat)
            start += flat.size
        else:
            parts += some
            start += sum(math.prod(np.shape(leaf)) for leaf in some)
    structure = Structure(tree, shapes, tuple(special), code_now(tree))
    if len(parts) == 1 and isinstance(parts[0], np.ndarray):
        return structure, parts[0]
    return structure, end_to_end(parts)


def numbers_apart(leaves: list, tree: Any) -> tuple[Structure, Float[np.ndarray, " p"], tuple[int, ...]]:
    """The structure of a system that is taken apart, and as of `split` its numbers that are known and where others
    are."""
    known, unknown = split(leaves)
    special = _special_but_for(known, unknown)
    return Structure(tree, tuple(map(np.shape, leaves)), special, code_now(tree)), known, unknown


def numbers_renewed(
    structure: Structure, known: Float[np.ndarray, " p"], leaves: list, changed: Sequence[slice]
) -> tuple[Structure, Float[np.ndarray, " p"], tuple[int, ...]]:
    """`numbers_apart` of a system that has other leaves at some places, to the same bits.

    Args:
        structure, known: of the system before.
        leaves: of the other system, whose tree and shapes are the same; elsewhere they are known.
        changed: where leaves may differ.
    """
    known, starts, unknown = known.copy(), structure.starts, []
    is_as_special = True
    for some in changed:
        for i, leaf in enumerate(leaves[some], some.start):
            first, last = starts[i], starts[i + 1]
            numbers = known[first:last].tolist()
            if is_concrete(leaf):
                known[first:last] = np.asarray(leaf, np.float64).ravel()
                numbers += known[first:last].tolist()
            else:
                known[first:last] = 0.0
                unknown += range(first, last)
            # None of them were special, or are: zeros that stand for what was traced count as special.
            is_as_special = is_as_special and not any(number in SPECIAL_VALUES for number in numbers)
    if is_as_special:
        return structure, known, tuple(sorted(unknown))
    return structure.for_special(_special_but_for(known, unknown)), known, tuple(sorted(unknown))


def _special_but_for(known: Float[np.ndarray, " p"], unknown: Collection[int]) -> tuple[tuple[int, float], ...]:
    """Numbers that are special, by their places, but for those that are not known."""
    hidden = set(unknown)
    return tuple((i, value) for i, value in special_in(known) if i not in hidden)


def traced_numbers(leaves: list) -> Float[Array, " n_unknown"]:
    """The numbers of a system that are not known, one after the other, from its leaves."""
    traced = [leaf for leaf in leaves if not is_concrete(leaf)]
    if len(traced) == 1 and traced[0].dtype == np.float64:  # one operation is less than one program
        return jnp.ravel(traced[0])
    return end_to_end(traced)


@jax.jit
def end_to_end(arrays: list) -> Float[Array, " n"]:
    """One vector of arrays; as one program, where `jax.vmap` would make one of each operation."""
    return jnp.concatenate([jnp.ravel(jnp.asarray(each, jnp.float64)) for each in arrays])


def with_laws_by_factor(system: System) -> System:
    """The system as its equations see it: laws of impact that differ in a factor alone are that factor, a number.

    A run of another such law then needs no other program. The system that users see keeps its laws.
    """
    return jax.tree.map(
        lambda part: by_factor(part) if isinstance(part, AbstractNormalLaw) else part,
        system,
        is_leaf=lambda part: isinstance(part, AbstractNormalLaw),
    )


def flatten_by_factor(system: System):
    """`flatten_system` of the system as its equations see it."""
    return flatten_system(with_laws_by_factor(system))


def split(system: System | list) -> tuple[Numeric, tuple[int, ...]]:
    """The numbers that are known now, with zeros elsewhere, and the indices of others; of a system or its leaves."""
    known, unknown, start = [], [], 0
    for leaf in jax.tree.leaves(system):
        size = int(np.prod(np.shape(leaf)))
        if is_concrete(leaf):
            known.append(np.asarray(leaf, np.float64).ravel())
        else:
            known.append(np.zeros(size))
            unknown.extend(range(start, start + size))
        start += size
    return np.concatenate(known), tuple(unknown)


@lru_cache(maxsize=64)
def example_of(structure: Structure) -> System:
    """A system of the structure, with shapes for numbers."""
    n_numbers = sum(int(np.prod(shape)) for shape in structure.shapes)
    return jax.eval_shape(structure.system, jax.ShapeDtypeStruct((n_numbers,), jnp.float64))
