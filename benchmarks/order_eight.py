"""Two explicit methods of order eight: `diffrax.Dopri8`, the choice, and `sj.solvers.Dop853`, which is there to be
asked for.

    python benchmarks/order_eight.py     # half a minute

Four-bars at four tolerances, on one core. The error is the largest of the rocker's height at 21 samples, against a run
by Dopri8 at a tolerance of 1e-12; where stability sets the steps it is far below what was asked for.
"""

from machine import median_seconds, use_one_core, write

use_one_core()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402

import spherejax as sj  # noqa: E402

TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
TIGHT = 1e-12
SOLVERS = (diffrax.Dopri8(), sj.solvers.Dop853())
MAX_STEPS = 1_000_000
CASES = {
    "ideal, 2 s": (sj.Ideal(), 2.0),
    "bushing k 1e6 N/m, b 1e-4 s, 2 s": (sj.Bushing(1e6, 1e-4), 2.0),
    "bushing k 1e6 N/m, b 3e-3 s, 0.5 s": (sj.Bushing(1e6, 3e-3), 0.5),
    "bushing k 1e8 N/m, b 1e-4 s, 0.5 s": (sj.Bushing(1e8, 1e-4), 0.5),
    "dry with friction, c 0.1 mm, 0.2 s": (sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1)), 0.2),
}


def rows_of(name: str, model: sj.joints.AbstractSphericalModel, duration: float) -> list[dict]:
    """Both methods at all tolerances."""
    scene, ts = sj.gallery.four_bar(model), jnp.linspace(0.0, duration, 21)

    def run(rtol: float, solver: diffrax.AbstractSolver) -> sj.Trajectory:
        found = sj.simulate(scene, ts, rtol=rtol, solver=solver, max_steps=MAX_STEPS, throw=True)
        return jax.block_until_ready(found)

    def height(found: sj.Trajectory) -> jax.Array:
        return found.position("rocker")[:, 2]

    exact = height(run(TIGHT, SOLVERS[0]))
    rows = []
    for rtol in TOLERANCES:
        for solver in SOLVERS:
            found = run(rtol, solver)
            error = float(jnp.max(jnp.abs(height(found) - exact)))
            milliseconds = 1e3 * median_seconds(lambda rtol=rtol, solver=solver: run(rtol, solver))
            rows.append(
                {
                    "case": name,
                    "method": type(solver).__name__,
                    "rtol": f"{rtol:.0e}",
                    "milliseconds": f"{milliseconds:.2f}",
                    "steps": int(found.stats.n_steps),
                    "error_max_m": f"{error:.1e}",
                }
            )
    return rows


if __name__ == "__main__":
    write(
        "order_eight",
        "python benchmarks/order_eight.py",
        [row for name, case in CASES.items() for row in rows_of(name, *case)],
    )
