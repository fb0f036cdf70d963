"""The equations of a scene as scalar programs of the values that an FMU can set, time and state.

All other numbers are constants of the programs, so that what they make zero or one falls out.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from spherejax.compiler import NotScalarizable, ScalarProgram, scalarize
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.model.system import System, compile_scene
from spherejax.motion.equations.contacts import crossings, initial_memory, memory_after_step
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.projection import corrected
from spherejax.motion.equations.quantities import value_at
from spherejax.motion.integration.audit import vitals
from spherejax.motion.integration.longest_step import room
from spherejax.motion.start.assembly import (
    UNMET_TOLERANCE,
    as_ideal,
    assembly_residuals,
    consistent_velocities,
    described_state,
    newton_step,
    unmet_demands,
)
from spherejax.output.fmu.ports import Ports
from spherejax.physics.state import unpack

LARGEST = 60_000
"""Scalar operations of the right-hand side up to which a C compiler takes seconds rather than minutes."""


class Written(NamedTuple):
    """A scene in programs.

    Attributes:
        programs: by the name of the function in C, each of (values, t, y).
        system: with the values of the scene.
        has_room: whether something is known of how soon what depends on time comes.
        reads_time: whether time enters the right-hand side by itself.
    """

    programs: dict[str, ScalarProgram]
    system: System
    has_room: bool
    reads_time: bool

    @property
    def c_prelude(self) -> str:
        """What a file of C needs ahead of the functions."""
        return ScalarProgram.C_PRELUDE

    def c_functions(self) -> list[str]:
        """The programs as functions of C.

        Raises:
            SceneError: for an operation that C does not have.
        """
        try:
            return [program.c_source(name) for name, program in self.programs.items()]
        except NotScalarizable as reason:
            raise SceneError(f'export_fmu: {reason}; export with kind="python"') from None


def written(scene: Scene, ports: Ports) -> Written:
    """The programs of a scene.

    Raises:
        SceneError: for laws that have no scalar program, and for scenes too large for one.
    """
    system = compile_scene(scene).system
    layout = system.layout
    size, n_start = layout.size, layout.memory_start
    n_contacts = len(system.contact_joints)

    def of(function: Callable, size: int, ideal: bool = False) -> ScalarProgram:
        return _program(scene, ports, function, size, ideal)

    knows_room = _room(system, jnp.zeros(()), jnp.zeros(size)) is not None
    programs = {
        "legal": _program(scene, ports, None, 1, False),
        "described": of(lambda system, t, y: described_state(system), n_start, True),
        "newton_step": of(newton_step, n_start, True),
        "velocities": of(consistent_velocities, n_start, True),
        "gaps": of(_gap, n_start, True),
        "open_gap": of(_open_gap if system.is_driven else _nothing, n_start, True),
        "first_memory": of(_first_memory, size),
        "rate": of(state_rate, size),
        "crossing": of(_crossing, size),
        "after": of(_after_step if n_contacts else _nothing, 2 * size + n_contacts),
        "correction": of(corrected if system.drift.n_corrections else _nothing, size),
        "outputs": of(outputs_of(ports.quantities), size),
        "vitals": of(_vitals, size),
        "room": of(_room if knows_room else _nothing, size),
    }
    return Written(programs, system, knows_room, programs["rate"].reads(1))


def _after_step(system: System, t: Any, packed: Any) -> Any:
    """`memory_after_step` of states and slopes one after the other."""
    size = system.layout.size
    return memory_after_step(system, t, (packed[:size], packed[size : 2 * size], packed[2 * size :]))


def _program(scene: Scene, ports: Ports, function: Callable | None, size: int, ideal: bool) -> ScalarProgram:
    def of_values(values, t, y):
        compiled = compile_scene(ports.scene_with(scene, values))
        if function is None:
            legal = jnp.all(jnp.stack(compiled.conditions)) if compiled.conditions else jnp.array(True)
            return jnp.where(legal, 1.0, 0.0)
        system = as_ideal(compiled.system) if ideal else compiled.system
        return jnp.ravel(function(system, t[0], y))

    shapes = [jax.ShapeDtypeStruct((n,), jnp.float64) for n in (len(ports.values), 1, size)]
    try:
        return scalarize(of_values, *shapes, maximum_operations=LARGEST)
    except NotScalarizable as reason:
        if reason.is_too_large:
            raise SceneError(
                f"export_fmu: the scene has more than {LARGEST} scalar operations, which no C compiler takes in "
                'reasonable time; export it with kind="python"'
            ) from None
        raise SceneError(
            f"export_fmu: a law of the scene cannot be written in C ({reason}). Write it with elementwise operations, "
            'jnp.where, dot and cross, or export with kind="python"'
        ) from None


def _nothing(system: System, t, y) -> Any:
    del system, t, y
    return jnp.zeros(0)


def _first_memory(system: System, t, y) -> Any:
    del t
    return initial_memory(system, y)


def _room(system: System, t, y) -> Any:
    return room(system, t, y)


def _gap(system: System, t, y) -> Any:
    gaps = assembly_residuals(system, t, y)
    largest = jnp.max(jnp.concatenate([jnp.zeros(1), *(jnp.abs(gap) for gap in gaps.values())]))
    if not system.is_driven:
        return largest
    unmet = unmet_demands(system, t, y)
    return jnp.maximum(largest, jnp.where(unmet > UNMET_TOLERANCE, unmet, 0.0))


def _open_gap(system: System, t, y) -> Any:
    """The largest residual of the joints that no driver moves [m or rad]."""
    gaps = assembly_residuals(system, t, y)
    kept = [jnp.abs(gap) for name, gap in gaps.items() if not system.joints[name].is_driven]
    return jnp.max(jnp.concatenate([jnp.zeros(1), *kept]))


def _crossing(system: System, t, y) -> Any:
    """Values, rates, and 1 where each counts as touching, else 0."""
    if not system.contact_joints and not system.touching_forces:
        return jnp.zeros(0)
    found = crossings(system, t, y)
    memory = unpack(system.layout, y).memory
    models: list[tuple[Any, slice]] = [
        (system.spherical(name).model, system.memory_of(name)) for name in system.contact_joints
    ]
    touching = [model.is_touching(memory[entries]) for model, entries in models]
    touching += [found.value[i] > 0 for i in range(len(models), found.value.shape[0])]
    return jnp.concatenate([found.value, found.rate, jnp.where(jnp.stack(touching), 1.0, 0.0)])


@lru_cache(maxsize=64)
def outputs_of(names: tuple[str, ...]) -> Callable:
    """The function of (system, time, state) that gives quantities one after the other; one for the same names."""

    def outputs(system: System, t, y):
        return jnp.concatenate([jnp.ravel(value_at(system, t, y, name)) for name in names])

    return outputs


def _vitals(system: System, t, y) -> Any:
    found = vitals(system, t, y)
    return jnp.stack([jnp.zeros(()) if each is None else jnp.asarray(each) for each in found])


def n_crossings(program: ScalarProgram) -> int:
    """How many contacts and touches there are."""
    return program.n_outputs // 3
