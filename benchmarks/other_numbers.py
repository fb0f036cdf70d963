"""Calls outside of `jax.jit` with other numbers of one scene: what they take beside the same scene again.

    python benchmarks/other_numbers.py     # one minute

The dry four-bar, 0.1 s, 51 samples: the same scene, another clearance (the scene built anew, or changed by
`eqx.tree_at`), another mass, and the gradient by the clearance; and what JAX takes for that gradient without a run:
another scene, a product, a row, a sum. Time of a call, median of 100, and calls of Python functions in it; each number
is another one.
"""

import cProfile
import pstats
import statistics
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from machine import write

import spherejax as sj

TS = jnp.linspace(0.0, 0.1, 51)
SCENE = sj.gallery.four_bar(sj.Dry(1e-4))


def with_clearance(clearance) -> sj.Scene:
    return eqx.tree_at(lambda scene: scene.joints["coupler_rocker"].model.clearance, SCENE, jnp.asarray(clearance))


def with_mass(mass) -> sj.Scene:
    return eqx.tree_at(lambda scene: scene.bodies["coupler"].mass, SCENE, jnp.asarray(mass))


def run(scene: sj.Scene) -> sj.Trajectory:
    return sj.simulate(scene, TS)


GRADIENT = jax.grad(lambda clearance: jnp.sum(run(with_clearance(clearance)).position("rocker")[-1]))
ROWS = jnp.ones((len(TS), 3))


@jax.grad
def without_run(clearance):
    joint: Any = with_clearance(clearance).joints["coupler_rocker"]
    return jnp.sum((joint.model.clearance * ROWS)[-1])


CLEARANCES = [1e-4 * (1 + 1e-4 * i) for i in range(130)]
CASES: dict[str, tuple[Callable, list]] = {
    "the same scene": (run, [SCENE] * 130),
    "another clearance, built": (run, [sj.gallery.four_bar(sj.Dry(clearance)) for clearance in CLEARANCES]),
    "another clearance, tree_at": (run, [with_clearance(clearance) for clearance in CLEARANCES]),
    "another mass, tree_at": (run, [with_mass(0.1 * (1 + 1e-4 * i)) for i in range(130)]),
    "gradient by the clearance": (GRADIENT, CLEARANCES),
    "gradient without a run": (without_run, CLEARANCES),
}


def main() -> None:
    rows = []
    for case, (call, arguments) in CASES.items():
        for argument in arguments[:10]:
            jax.block_until_ready(call(argument))
        times = []
        for argument in arguments[10:110]:
            begin = time.perf_counter()
            jax.block_until_ready(call(argument))
            times.append(time.perf_counter() - begin)
        profile = cProfile.Profile()
        profile.enable()
        for argument in arguments[110:]:
            call(argument)
        profile.disable()
        n_calls = getattr(pstats.Stats(profile), "total_calls") // len(arguments[110:])  # noqa: B009 - not in its types
        rows.append({"call": case, "milliseconds": f"{1e3 * statistics.median(times):.2f}", "python_calls": n_calls})
    write("other_numbers", "python benchmarks/other_numbers.py", rows)


if __name__ == "__main__":
    main()
