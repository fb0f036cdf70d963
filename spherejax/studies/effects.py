"""What is compiled into a scene, and what each effect costs."""

import time
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from spherejax.model.scene import Scene
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.dynamics import state_rate
from spherejax.motion.equations.programs import path_of, program_for
from spherejax.motion.integration.compiling import native_run
from spherejax.motion.integration.problem import initial_state
from spherejax.motion.start.assembly import as_ideal, assemble_now
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.ideal import Ideal

_REPEATS = 5
_CALLS = 20_000
_WIGGLE = 1e-12


class EffectRow(NamedTuple):
    """One effect and the scene up to it.

    Attributes:
        joint: the joint that brings the effect in; empty for the ideal scene.
        effect: name of the effect.
        n_states: states that are integrated, with this effect and those above it.
        n_constraints: constraint rows.
        n_memory: memory entries among the states.
        n_operations: scalar operations per right-hand side in the integration loop; 0 on array code, which has none.
        n_operations_ahead: scalar operations that depend on parameters alone, done once before the loop.
        microseconds: time per right-hand side, one trajectory, one core, compiled as it is in a run [us]; NaN when not
            timed.
    """

    joint: str
    effect: str
    n_states: int
    n_constraints: int
    n_memory: int
    n_operations: int
    n_operations_ahead: int
    microseconds: float


class Effects(NamedTuple):
    """What a scene calls for, effect by effect, beside the ideal scene; prints as a table.

    Attributes:
        rows: the ideal scene, then each effect upon those before it.
        note: what is said below the table; empty where every row is a scalar program.
    """

    rows: tuple[EffectRow, ...]
    note: str = ""

    def __str__(self) -> str:
        head = ("joint", "effect", "states", "rows", "memory", "operations", "ahead", "us/rhs", "x ideal")
        base = self.rows[0].microseconds
        lines: list[tuple[str, ...]] = [head]
        for row in self.rows:
            timed = np.isfinite(row.microseconds)
            lines.append(
                (
                    row.joint,
                    row.effect,
                    *map(str, row[2:5]),
                    *(map(str, row[5:7]) if row.n_operations else "--"),
                    f"{row.microseconds:.2f}" if timed else "-",
                    f"{row.microseconds / base:.2f}" if timed else "-",
                )
            )
        widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
        padded = [
            "  ".join(
                cell.ljust(width) if i < 2 else cell.rjust(width)
                for i, (cell, width) in enumerate(zip(line, widths, strict=True))
            ).rstrip()
            for line in lines
        ]
        said = [f"The scene runs on {self.note}."] if self.note else []
        return "\n".join([padded[0], "-" * len(padded[0]), *padded[1:], *said])


def effects(scene: Scene, *, timed: bool = True) -> Effects:
    """What is compiled into a scene, and what each effect adds.

    The first row is the scene with every joint ideal; each further row adds one effect of one joint: the
    states, constraint rows and memory of the scene so far, the scalar operations of its right-hand side, and the time
    of one evaluation inside a compiled loop (median of five).

    Args:
        scene: the scene.

    Other args:
        timed: measure the time; False gives the counts only (and is quick).

    Returns:
        Rows that print as a table.

    Raises:
        SceneError: for a scene that cannot be simulated.
    """
    models = {name: getattr(joint, "model", Ideal()) for name, joint in scene.joints.items()}
    modeled = {name: model for name, model in models.items() if model.effects}
    built = scene
    for name in modeled:
        built = _with_model(built, name, Ideal())
    rows = [_row(built, "", "ideal scene", timed)]
    for name, model in modeled.items():
        for effect in model.effects:
            built = _with_model(built, name, effect.model)
            rows.append(_row(built, name, effect.name, timed))
    return Effects(tuple(rows), path_of(flatten_system(compile_scene(scene).system)[0]).reason)


def _with_model(scene: Scene, joint: str, model: AbstractSphericalModel) -> Scene:
    return eqx.tree_at(lambda s: s.joints[joint].model, scene, model)


def _row(scene: Scene, joint: str, effect: str, timed: bool) -> EffectRow:
    system = compile_scene(scene).system
    structure, theta = flatten_system(system)
    program = program_for(state_rate, structure)
    scalar = program.scalar
    inside = scalar.n_operations_inside if scalar else 0
    return EffectRow(
        joint,
        effect,
        system.layout.size,
        system.n_constraints,
        system.layout.n_memory,
        inside,
        scalar.n_operations - inside if scalar else 0,
        _microseconds(system, program, jnp.asarray(theta)) if timed else float("nan"),
    )


def _microseconds(system, program, theta) -> float:
    """Time of one right-hand side [us] in a compiled loop that it cannot be moved out of."""
    start = assemble_now(*flatten_system(as_ideal(system)))
    y0 = initial_state(system, jax.tree.map(jnp.asarray, start))

    @jax.jit
    def loop(theta, y):
        ahead = program.ahead(theta)

        def turn(_, state):
            return state + _WIGGLE * program.inside(theta, ahead, 0.0, state)

        # As the loop of a run is compiled.
        return native_run(lambda: jax.lax.fori_loop(0, _CALLS, turn, y), program.scalar is not None)

    loop(theta, y0).block_until_ready()
    seconds = []
    for _ in range(_REPEATS):
        begin = time.perf_counter()
        loop(theta, y0).block_until_ready()
        seconds.append(time.perf_counter() - begin)
    return float(np.median(seconds)) / _CALLS * 1e6
