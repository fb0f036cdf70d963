"""A scene that differs from one before in a few numbers: what they change is made anew, all else is taken over.

To check a scene, to place its joints and to take it apart costs more than most of its runs. Nothing is taken over on
trust:

* the tree structures of both scenes are equal, with all that is static in them, and all of it is this package's;
* the bits of all leaves are compared. A part with another leaf goes through the code that all parts of a new scene go
  through; parts are placed by the geometry of bodies alone (`system.BodyGeometry`), which is the same;
* what such a part says of itself for the whole (its memory, whether it conserves energy) must be what it said before.

Where one of these fails there is no renewal, and the scene is compiled from the start: one with an error is, so that
errors and their order are those of a new scene.
"""

from collections.abc import Hashable, Mapping
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.core
import numpy as np

from spherejax.foundations.behind_tracers import known_behind
from spherejax.foundations.checks import called, enforce, is_concrete, is_tracing
from spherejax.foundations.errors import SceneError
from spherejax.model.picking import places_of_leaves
from spherejax.model.scene import Scene, all_hold, conditions_of, scene_requirements
from spherejax.model.system import (
    BodyGeometry,
    System,
    for_masses,
    is_own,
    moving_body,
    with_laws_by_factor,
)
from spherejax.physics.bodies import Body
from spherejax.physics.forces.remembering import memory_entries
from spherejax.physics.joints.lubricated import Lubricated
from spherejax.physics.memory import MemoryEntry
from spherejax.program_cache.keys import KeyedTree, LruCache, own

NOT_DRAWN = frozenset((0, 1, 4, 5))
"""Mass, inertia and the two velocities, by their places among the leaves of a body: no part is placed by these."""

N_ROUTES = 64
"""Ways of numbers into the system that are kept for scenes of one structure; the least recently used is evicted."""

FIELDS = {"body": "bodies", "joint": "joints", "force": "forces"}
"""Where the parts of each kind are, in a scene and in a system."""


class Taken(NamedTuple):
    """A system, or a part of one, taken apart.

    Attributes:
        leaves: its numbers.
        tree: its structure.
    """

    leaves: list
    tree: Any

    @classmethod
    def apart(cls, whole: Any) -> "Taken":
        """What is taken apart; arrays of NumPy, in which a user may write, are copied."""
        leaves, tree = jax.tree.flatten(whole)
        return cls(list(map(own, leaves)), tree)

    def without_traced(self) -> "Taken":
        """With None in place of what is traced."""
        return Taken([leaf if is_concrete(leaf) else None for leaf in self.leaves], self.tree)

    def whole(self) -> Any:
        """Put together again."""
        return jax.tree.unflatten(self.tree, self.leaves)


class Renewed(NamedTuple):
    """What a renewal makes.

    Attributes:
        system: the system; its numbers are known where those of the scene are.
        seen: the same with laws by their factors.
        changed: where leaves of `seen` may be others than before.
        doubts_remain: whether all that doubts of the start are made of is as before.
        conditions: on traced values.
    """

    system: Taken
    seen: Taken
    changed: tuple[slice, ...]
    doubts_remain: bool
    conditions: list


def traced_places(reading: KeyedTree) -> tuple[int, ...]:
    """Which leaves of a scene are traced, or cannot be compared."""
    return tuple(i for i, value in enumerate(reading.values) if value is None)


class Compilation:
    """A compiled scene from which others can be renewed, in which the same leaves are traced.

    Attributes:
        system, seen: the system that it calls for, and that with laws by their factors; None in place of leaves that
            are traced.
    """

    def __init__(self, values: tuple, system: Taken, seen: Taken, frame: "_SharedByScenes"):
        self.system, self.seen = system, seen
        self._values, self._frame = values, frame

    @classmethod
    def of(cls, reading: KeyedTree, system: Taken, seen: Taken) -> "Compilation | None":
        """Of a scene that was compiled from the start; None where no other can be renewed from it."""
        if reading.user_code != "" or not is_own(reading.structure):
            return None
        if not all(type(body) is Body for body in reading.tree.bodies.values()):
            return None
        pairs = zip(reading.values, reading.leaves, strict=True)
        values = tuple(_traced(leaf) if value is None else value for value, leaf in pairs)
        if None in values:
            return None
        shared = _SharedByScenes(reading.structure, system, seen)
        if reading.key is None:
            shared.ask()  # while what is traced is there, which nobody may hold
            shared.let_go()
            return cls(values, system.without_traced(), seen.without_traced(), shared)
        return cls(values, system, seen, shared)

    def followed_by(self, reading: KeyedTree, renewed: Renewed) -> "Compilation":
        """That of a scene of known numbers that was renewed from this one."""
        return Compilation(reading.values, renewed.system, renewed.seen, self._frame)

    def renewed(self, reading: KeyedTree) -> Renewed | None:
        """What a scene of the same structure calls for; None where it has to be compiled from the start."""
        pairs = zip(self._values, reading.values, strict=True)
        changed = [i for i, (old, new) in enumerate(pairs) if old != new]
        if not all(_is_alike(self._values[i], reading.leaves[i]) for i in changed):
            return None
        parts = self._frame.parts_of(changed)
        if parts is None:
            return None
        try:
            routes = None if self._frame.gravity[0] in changed else self._frame.routes_of(parts, changed, reading)
            if routes is not None:
                return self._along(routes, parts, reading)
            renewed = self._renewed(parts, changed, reading.tree)
        except SceneError:  # it is raised again, in its order
            return None
        if renewed is not None:
            self._frame.find_routes(parts, changed, reading, renewed)
        return renewed

    def _along(self, routes: list["_Route"], parts: list["_PlacesOfPart"], reading: KeyedTree) -> Renewed | None:
        """What a scene calls for whose numbers go straight into the system: no part is placed."""
        conditions = []
        for part in parts:
            of_part = reading.leaves[part.described]
            behind = known_behind(of_part)
            if len(behind) == 1 and (behind[0] is of_part or not is_tracing()):
                described = self._frame.in_numpy(part, behind[0])
                if all_hold(called(described, "requirements")):
                    continue
            # An error is raised, in its order, by who compiles from the start.
            described = getattr(reading.tree, FIELDS[part.kind])[part.name]
            conditions += enforce(f"{part.kind} {part.name!r}", called(described, "requirements"))
        if any(part.kind == "body" for part in parts) and not self._frame.is_for_masses_of(reading.tree):
            return None
        system, seen = list(self.system.leaves), list(self.seen.leaves)
        changed = []
        for route in routes:
            leaf = own(reading.leaves[route.leaf])
            for at in route.placed:
                system[at] = leaf
            for at in route.seen:
                seen[at] = leaf
                changed.append(slice(at, at + 1))
        trees = self.system.tree, self.seen.tree
        return Renewed(Taken(system, trees[0]), Taken(seen, trees[1]), tuple(changed), True, conditions)

    def _renewed(self, parts: list["_PlacesOfPart"], leaves: list[int], scene: Scene) -> Renewed | None:
        system, seen = list(self.system.leaves), list(self.seen.leaves)
        conditions, doubts_remain = [], True
        changed = [part.seen for part in parts]
        at, placed, by_factor = self._frame.gravity
        if at in leaves:
            conditions += [one for where, what in scene_requirements(scene) for one in enforce(where, what)]
            system[placed] = seen[by_factor] = own(scene.gravity)
            changed.append(slice(by_factor, by_factor + 1))
        for part in parts:
            described: Any = getattr(scene, FIELDS[part.kind])[part.name]
            conditions += conditions_of(f"{part.kind} {part.name!r}", described)
            made = self._frame.made(part, described, scene)
            if made is None:
                return None
            doubts_remain = doubts_remain and (part.kind != "joint" or not self._may_be_doubted(part, made))
            one, other = Taken.apart(made), Taken(*jax.tree.flatten(with_laws_by_factor(made)))
            if one.tree != part.placed_tree or other.tree != part.seen_tree:
                return None
            system[part.placed], seen[part.seen] = one.leaves, other.leaves
        if any(part.kind == "body" for part in parts) and not self._frame.is_for_masses_of(scene):
            return None
        trees = self.system.tree, self.seen.tree
        return Renewed(Taken(system, trees[0]), Taken(seen, trees[1]), tuple(changed), doubts_remain, conditions)

    def _may_be_doubted(self, part: "_PlacesOfPart", joint: Any) -> bool:
        """Whether a joint may give reasons for doubt that it did not give before: another place, or another film."""
        before = jax.tree.unflatten(part.placed_tree, self.system.leaves[part.placed])
        places = (*before.points, *joint.points)
        if isinstance(getattr(joint, "model", None), Lubricated) or not all(map(is_concrete, places)):
            return True
        return not all(map(np.array_equal, before.points, joint.points))


class _Route(NamedTuple):
    """Where a number of a scene stands in the system and in that with laws by their factors, handed on as it is."""

    leaf: int
    placed: tuple[int, ...]
    seen: tuple[int, ...]


class _PlacesOfPart(NamedTuple):
    """A part of a scene: where its leaves are in the scene, in the system, and in that with laws by their factors; of
    the two systems its structures too."""

    kind: str
    name: str
    described: slice
    placed: slice
    placed_tree: Any
    seen: slice
    seen_tree: Any


class _SharedByScenes:
    """What scenes of one structure share that are renewed from each other; found when it is first asked for."""

    def __init__(self, structure: Any, system: Taken, seen: Taken):
        self._of = structure, system.tree, seen.tree
        self._system: Taken | None = system
        self._drawn: dict[str, BodyGeometry] | None = None

    @cached_property
    def _parts(self) -> tuple[_PlacesOfPart, ...]:
        described, placed, by_factor = map(_places, self._of)
        return tuple(
            _PlacesOfPart(kind, name, at, *placed[field, name], *by_factor[field, name])
            for kind, field in FIELDS.items()
            for (of, name), (at, _) in described.items()
            if of == field
        )

    @cached_property
    def gravity(self) -> tuple[int, int, int]:
        """Where it is among the leaves of the scene and of the two systems: behind the parts."""
        first, *others = (sum(child.num_leaves for child in tree.children()[: len(FIELDS)]) for tree in self._of)
        return first, others[0], others[1]

    @cached_property
    def _part_of(self) -> list[int | None]:
        part_of: list[int | None] = [None] * self._of[0].num_leaves
        for k, part in enumerate(self._parts):
            part_of[part.described] = [k] * (part.described.stop - part.described.start)
        return part_of

    @cached_property
    def _whole(self) -> System:
        assert self._system is not None
        return self._system.whole()

    @cached_property
    def _said(self) -> dict[tuple[str, str], tuple | None]:
        joints, forces = self._whole.joints.items(), self._whole.forces.items()
        of_joints = {("joint", name): _said_of_joint(joint) for name, joint in joints}
        return of_joints | {("force", name): _said_of_force(force) for name, force in forces}

    def ask(self) -> None:
        """Find out now what is asked for later."""
        self._said, self._masses = self._said, self._masses

    def let_go(self) -> None:
        """Hold the system no longer."""
        self._system = None
        vars(self).pop("_whole", None)

    @cached_property
    def _masses(self) -> tuple[bool, bool, float]:
        whole = self._whole
        return whole.is_driven, whole.refines_constraints, whole.smallest_pivot

    def parts_of(self, leaves: list[int]) -> list[_PlacesOfPart] | None:
        """The parts that leaves belong to; None where another geometry or drift control is among them."""
        parts = {self._part_of[i] for i in leaves}
        for i in leaves:
            part = self._part_of[i]
            if i == self.gravity[0]:
                continue
            if part is None:
                return None
            kind, _, described, *_ = self._parts[part]
            if kind == "body" and i - described.start not in NOT_DRAWN:
                return None
        return [part for k, part in enumerate(self._parts) if k in parts]

    def made(self, part: _PlacesOfPart, described: Any, scene: Scene) -> Any:
        """What is made of a part for the system; None where it says something else of itself than before."""
        if part.kind == "body":
            return moving_body(described)
        if self._drawn is None:  # of any of these scenes: they have the same geometry
            self._drawn = {name: jax.tree.map(own, BodyGeometry.of(body)) for name, body in scene.bodies.items()}
        placed = called(described, "placed", self._drawn, partial(called, scene, "find"))
        said = _said_of_joint(placed) if part.kind == "joint" else _said_of_force(placed)
        return placed if said is not None and said == self._said[part.kind, part.name] else None

    @cached_property
    def _routes(self) -> LruCache:
        """Of numbers of a part that have changed while its others have the values of the key."""
        return LruCache(N_ROUTES)

    def _key_of(self, part: _PlacesOfPart, leaves: list[int], reading: KeyedTree) -> Hashable:
        # What is done with a number may depend on the others: a law by its factor, on the exponent.
        start, stop = part.described.start, part.described.stop
        changed = tuple(i for i in leaves if start <= i < stop)
        kinds = tuple(_kind_of(reading.leaves[i]) for i in changed)
        others = tuple(reading.values[i] for i in range(start, stop) if i not in changed)
        return part.kind, part.name, changed, kinds, others

    def routes_of(self, parts: list[_PlacesOfPart], leaves: list[int], reading: KeyedTree) -> list[_Route] | None:
        """Those of leaves that have changed; None where one is not handed on as it is, or not known to be."""
        routes = [self._routes.find(self._key_of(part, leaves, reading)) for part in parts]
        return None if None in routes else [route for of_part in routes for route in of_part]

    def in_numpy(self, part: _PlacesOfPart, leaves: list) -> Any:
        """A part of a scene, of leaves that are known; JAX takes ten times as long for each comparison."""
        _, tree = _places(self._of[0])[FIELDS[part.kind], part.name]
        return jax.tree.unflatten(tree, [np.asarray(x) if isinstance(x, jax.Array) else x for x in leaves])

    def find_routes(self, parts: list[_PlacesOfPart], leaves: list[int], reading: KeyedTree, renewed: Renewed) -> None:
        """Find out which of the leaves that have changed are handed on as they are."""
        for part in parts:
            changed = [i for i in leaves if part.described.start <= i < part.described.stop]
            routes = self._found_routes(part, changed, reading)
            # What is made of a number may be of another type, of which other scenes would differ.
            if routes is not None and all(
                _are_same(taken.leaves[at], reading.leaves[route.leaf])
                for route in routes
                for taken, places in ((renewed.system, route.placed), (renewed.seen, route.seen))
                for at in places
            ):
                self._routes.put(self._key_of(part, leaves, reading), routes)

    def _found_routes(self, part: _PlacesOfPart, changed: list[int], reading: KeyedTree) -> list[_Route] | None:
        _, tree = _places(self._of[0])[FIELDS[part.kind], part.name]
        leaves, among = reading.leaves[part.described], [i - part.described.start for i in changed]

        def placed(described: Any) -> Any:
            made = self.made(part, described, reading.tree)
            if isinstance(getattr(made, "model", None), Lubricated):  # of a film there may be doubts
                return None
            return made

        def points(described: Any) -> Any:
            return [] if part.kind == "body" else getattr(placed(described), "points", ())

        def seen(described: Any) -> Any:
            return with_laws_by_factor(placed(described))

        in_points, *others = (places_of_leaves(of, tree, leaves, among) for of in (points, placed, seen))
        if in_points is None or any(in_points[1]):
            return None
        places = []
        of_systems = (part.placed_tree, part.placed), (part.seen_tree, part.seen)
        for found, (wanted, of_part) in zip(others, of_systems, strict=True):
            if found is None or found[0] != wanted:
                return None
            places.append([tuple(of_part.start + at for at in of_leaf) for of_leaf in found[1]])
        return [_Route(*route) for route in zip(changed, *places, strict=True)]

    def is_for_masses_of(self, scene: Scene) -> bool:
        """Whether other masses and moments are as far apart as those before."""
        is_driven, *of_masses = self._masses
        return for_masses(scene.bodies, is_driven) == tuple(of_masses)


@lru_cache(maxsize=256)
def _places(tree: Any) -> Mapping[tuple[str, str], tuple[slice, Any]]:
    """Where the leaves of each part of a scene or a system are, and their structure, by field and name."""
    places, start = {}, 0
    for field, of_field in zip(FIELDS.values(), tree.children(), strict=False):  # gravity and others follow
        _, names = of_field.node_data()  # sorted, by JAX
        for name, part in zip(names, of_field.children(), strict=True):
            places[field, name] = slice(start, start + part.num_leaves), part
            start += part.num_leaves
    return places


def _traced(leaf: Any) -> tuple | None:
    """What stands for a traced number: its form, and no value that another one could have; None for anything else."""
    is_number = isinstance(leaf, jax.core.Tracer) and leaf.dtype == np.float64
    return (jax.core.Tracer, "<f8", leaf.shape, object()) if is_number else None


def _is_alike(old: tuple, new: Any) -> bool:
    """Whether a leaf that has changed has a form that was found right before: real numbers of the same shape."""
    shape = () if old[0] is float else old[2] if len(old) == 4 and old[1] == "<f8" else None
    if type(new) is float:
        return shape == ()
    is_array = type(new) in (np.float64, np.ndarray) or isinstance(new, jax.Array)  # tracers among these
    return is_array and new.shape == shape and new.dtype == np.float64


def _kind_of(leaf: Any) -> type:
    return type(leaf) if is_concrete(leaf) else jax.core.Tracer


def _are_same(a: Any, b: Any) -> bool:
    if a is b or type(a) is not type(b) or not is_concrete(a):
        return a is b
    return np.shape(a) == np.shape(b) and np.asarray(a).tobytes() == np.asarray(b).tobytes()


def _said_of_joint(joint: Any) -> tuple | None:
    """What a placed joint says of itself for the whole; None where a number in it is traced."""
    memory = _in_values(joint.memory)
    return None if memory is None else (memory, joint.is_driven, joint.never_adds_energy, joint.conserves_energy)


def _said_of_force(force: Any) -> tuple | None:
    """The same of a force element."""
    memory = _in_values(memory_entries(force))
    return None if memory is None else (memory, force.never_adds_energy, force.conserves_energy)


def _in_values(memory: tuple[MemoryEntry, ...]) -> tuple | None:
    if not all(is_concrete(entry.scale) for entry in memory):
        return None
    return tuple(e if isinstance(e.scale, str) else e._replace(scale=float(e.scale)) for e in memory)
