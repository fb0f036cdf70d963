"""What it costs to judge the errors of sensitivities, and what it costs not to: steps, and the error of a gradient.

    python benchmarks/sensitivity_tolerance.py     # about ten minutes, most of it compiling

Dry four-bar with friction, 0.2 s, thirty onsets, rtol 1e-8; the rocker's last position by clearance, friction
coefficient and restitution together, each scaled by its number, against the same at an rtol of 1e-12. A factor is how
much larger the errors of sensitivities may be than the state's
(`spherejax.motion.integration.lanes.landing.SLOPES_TOLERANCE`).
"""

import jax
import jax.numpy as jnp
from machine import write

import spherejax as sj
from spherejax.motion.integration.lanes import landing

TS = jnp.linspace(0.0, 0.2, 3)
NUMBERS = jnp.array([1e-4, 0.1, 0.9])
FACTORS = (1.0, 2.0, 20.0, 100.0, 1000.0)


def end(numbers, rtol):
    """The rocker's last position [m], and the steps of the run."""
    clearance, mu, restitution = numbers
    normal = sj.LankaraniNikravesh(restitution)
    joint = sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu=mu, v1=1e-3))
    run = sj.simulate(sj.gallery.four_bar(joint), TS, rtol=rtol)
    return run.position("rocker")[-1], run.stats.n_steps


def slopes(rtol: float, factor: float):
    """Scaled derivatives [m], and the steps of the run that carries them."""
    landing.SLOPES_TOLERANCE = factor  # read while the program is traced
    jax.clear_caches()

    def along(direction):
        return jax.jvp(lambda numbers: end(numbers, rtol), (NUMBERS,), (direction,))

    (_, n_steps), (found, _) = jax.jit(jax.vmap(along))(jnp.diag(NUMBERS))
    return found, int(n_steps[0])


def main() -> None:
    """Print the table and write it."""
    plain = int(jax.jit(end, static_argnums=1)(NUMBERS, 1e-8)[1])
    reference, _ = slopes(1e-12, 1.0)
    rows: list[dict[str, object]] = []
    for factor in FACTORS:
        found, n_steps = slopes(1e-8, factor)
        error = float(jnp.max(jnp.abs(found - reference)) / jnp.max(jnp.abs(reference)))
        rows.append({"factor": factor, "steps": n_steps, "of_plain": f"{n_steps / plain:.2f}", "error": f"{error:.1e}"})
        print(rows[-1], flush=True)
    write("sensitivity_tolerance", "python benchmarks/sensitivity_tolerance.py", rows)


if __name__ == "__main__":
    main()
