"""Runs per second and core: a batch of 64 by `jax.vmap` against the hand-written DOP853 in a loop.

    python benchmarks/batches.py                              # about 2 minutes
    python benchmarks/batches.py ideal                        # one case

The runs differ in the rocker's mass (ideal) or the bushing's stiffness, over 20 percent. Each side runs at the loosest
tolerance of 1e-5 ... 1e-9 with which the worst of its 64 final heights is within 1e-9 m of the reference (DOP853 at
1e-12). The ideal batch assembles its start within the batch, for the mass is traced; the loop is given its starts.
"""

import sys
import time

from machine import median_seconds, use_one_core, write

use_one_core()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from baselines import parameters as at  # noqa: E402
from baselines.dop853 import integrator  # noqa: E402
from baselines.parameters import N_STATE, problem  # noqa: E402

import spherejax as sj  # noqa: E402

N_RUNS = 64
DURATION = 2.0
TOLERANCES = (1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 3e-9, 1e-9)
ACCURACY = 1e-9
HEIGHT = 16
FACTORS = np.linspace(0.9, 1.1, N_RUNS)


def ideal_scene(factor):
    """The ideal four-bar with a heavier or lighter rocker."""
    scene = sj.gallery.four_bar()
    return eqx.tree_at(lambda s: s.bodies["rocker"].mass, scene, scene.bodies["rocker"].mass * factor)


def bushing_scene(factor):
    """The four-bar with a stiffer or softer bushing."""
    return sj.gallery.four_bar(sj.Bushing(1e6 * factor, 1e-4))


def with_heavier_rocker(p, factor):
    p[at.INVERSE_MASS + 2] /= factor


def with_stiffer_bushing(p, factor):
    p[at.STIFFNESS] *= factor


CASES = {
    "ideal": (ideal_scene, sj.Ideal(), with_heavier_rocker),
    "bushing": (bushing_scene, sj.Bushing(1e6, 1e-4), with_stiffer_bushing),
}


def by_spherejax(scene_of):
    """A compiled batch from a tolerance to 64 final heights [m]."""
    ts = jnp.array([0.0, DURATION])

    @jax.jit
    def batch(tolerance, factors):
        def height(factor):
            motion = sj.simulate(scene_of(factor), ts, rtol=tolerance, atol=tolerance * 1e-3)
            return motion.position("rocker")[-1, 2]

        return jax.vmap(height)(factors)

    return lambda tolerance: np.asarray(batch(tolerance, jnp.asarray(FACTORS)))


def by_hand(model, modified):
    """The loop over the hand-written DOP853."""
    numbers = problem(model)
    run, ts, sets = integrator(numbers.kind), np.array([0.0, DURATION]), []
    for factor in FACTORS:
        p = numbers.parameters.copy()
        modified(p, factor)
        sets.append(p)

    def loop(tolerance):
        heights, ys = np.empty(N_RUNS), np.empty((2, N_STATE))
        for i, p in enumerate(sets):
            run(numbers.y0, ts, tolerance, tolerance * 1e-3, p, ys)
            heights[i] = ys[-1, HEIGHT]
        return heights

    return loop


def accurate_enough(batch, reference) -> tuple[float, float]:
    """The loosest tolerance that reaches the accuracy, and its worst error [m]."""
    for tolerance in TOLERANCES:
        error = float(np.abs(batch(tolerance) - reference).max())
        if error < ACCURACY:
            break
    return tolerance, error


def main() -> None:
    rows = []
    for name in sys.argv[1:] or CASES:
        scene_of, model, modified = CASES[name]
        by_loop = by_hand(model, modified)
        reference = by_loop(1e-12)
        for label, batch in (("numba DOP853, loop", by_loop), ("spherejax, vmap", by_spherejax(scene_of))):
            begin = time.perf_counter()
            tolerance, error = accurate_enough(batch, reference)
            rate = N_RUNS / median_seconds(lambda batch=batch, tolerance=tolerance: batch(tolerance), 3)
            rows.append(
                {
                    "case": f"{name}, {DURATION:.0f} s, {N_RUNS} runs",
                    "method": label,
                    "rtol": f"{tolerance:.0e}",
                    "worst_error_m": f"{error:.1e}",
                    "runs_per_second": f"{rate:.0f}",
                }
            )
            print(rows[-1], f"{time.perf_counter() - begin:.0f} s", flush=True)
    write("batches", "python benchmarks/batches.py", rows, ("numba",))


if __name__ == "__main__":
    main()
