"""Microseconds per right-hand side, array code against scalar program, one trajectory and a batch of 64.

python benchmarks/right_hand_side.py
"""

from machine import median_seconds, use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

import spherejax as sj  # noqa: E402
from spherejax.model.system import compile_scene, flatten_system  # noqa: E402
from spherejax.motion.equations.dynamics import state_rate  # noqa: E402
from spherejax.motion.equations.programs import program_for  # noqa: E402
from spherejax.motion.integration.problem import initial_state  # noqa: E402
from spherejax.motion.start.assembly import as_ideal, assemble_now  # noqa: E402

MODELS = {
    "ideal": sj.Ideal(),
    "dry, Hertz": sj.Dry(1e-4, normal=sj.Hertz()),
    "dry": sj.Dry(1e-4),
    "dry, Threlfall": sj.Dry(1e-4, friction=sj.Threlfall()),
    "dry, LuGre": sj.Dry(1e-4, friction=sj.LuGre()),
    "lubricated": sj.Lubricated(1e-4),
    "lubricated, paper's film": sj.Lubricated(1e-4, film=sj.laws.RadialFilm(), normal=sj.LankaraniNikravesh(0.9)),
    "bushing": sj.Bushing(1e6, 1e-4),
    "bushing, six components": sj.Bushing(
        law=sj.laws.MatrixElastomer.cylindrical(
            jnp.array([0.0, 1.0, 0.0]),
            radial_stiffness=1e6,
            axial_stiffness=5e5,
            conical_stiffness=1e2,
            torsional_stiffness=5e1,
            damping=1e-4,
        )
    ),
}


def microseconds(model, batch: int, scalar: bool) -> tuple[float, int]:
    """Time per trajectory of one right-hand side in a compiled loop [us], and its scalar operations."""
    system = compile_scene(sj.gallery.four_bar(model)).system
    structure, theta = flatten_system(system)
    program = program_for(state_rate, structure, scalar)
    start = jax.tree.map(jnp.asarray, assemble_now(*flatten_system(as_ideal(system))))
    y0 = initial_state(system, start)
    n_calls = (200_000 if scalar else 10_000) // batch

    def loop(theta, y):
        ahead = program.ahead(theta)

        def body(_, state):
            return state + 1e-12 * program.inside(theta, ahead, 0.0, state)

        return jax.lax.fori_loop(0, n_calls, body, y)

    run = jax.jit(loop if batch == 1 else jax.vmap(loop, (None, 0)))
    state = y0 if batch == 1 else jnp.tile(y0, (batch, 1))
    numbers = jnp.asarray(theta)
    seconds = median_seconds(lambda: run(numbers, state).block_until_ready())
    operations = program.scalar.n_operations_inside if program.scalar else 0
    return seconds / n_calls / batch * 1e6, operations


def main() -> None:
    rows = []
    for name, model in MODELS.items():
        array_one, _ = microseconds(model, 1, scalar=False)
        array_many, _ = microseconds(model, 64, scalar=False)
        one, operations = microseconds(model, 1, scalar=True)
        many, _ = microseconds(model, 64, scalar=True)
        rows.append(
            {
                "model": name,
                "scalar_operations": operations,
                "array_us_B1": f"{array_one:.2f}",
                "scalar_us_B1": f"{one:.3f}",
                "ratio_B1": f"{array_one / one:.1f}",
                "array_us_B64": f"{array_many:.2f}",
                "scalar_us_B64": f"{many:.3f}",
                "ratio_B64": f"{array_many / many:.1f}",
            }
        )
    write("right_hand_side", "python benchmarks/right_hand_side.py", rows)


if __name__ == "__main__":
    main()
