"""Derivatives of the lubricated four-bar by viscosity and clearance: how exact, and what they cost.

    python benchmarks/film_gradient.py

Forward sensitivities at rtol 1e-8 and 1e-10 against central differences of runs at 1e-12, and the time of a value
with its derivatives by `jax.jacfwd` against that of the value.
"""

import time

from machine import use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402

TURNS = 7
RTOLS = (1e-8, 1e-10)
CASES = {"0.2 s": 0.2, "2 s": 2.0}
POINT = jnp.array([0.4, 1e-4])
SHIFTS = (1e-4, 1e-4)
"""Of the differences, relative."""


def height(numbers, seconds, rtol):
    viscosity, clearance = numbers
    scene = sj.gallery.four_bar(sj.Lubricated(clearance, viscosity=viscosity))
    run = sj.simulate(scene, jnp.array([0.0, seconds]), rtol=rtol)
    return run.position("rocker")[-1, 2], run.stats.n_steps


def derivatives_by_differences(seconds):
    """Of runs at 1e-12, with two shifts and Richardson's rule: their error falls to the fourth order."""
    exact = jax.jit(lambda x: height(x, seconds, 1e-12)[0])
    wanted = []
    for i, shift in enumerate(SHIFTS):
        slopes = []
        for h in (shift, shift / 2):
            step = h * POINT[i] * jnp.eye(2)[i]
            slopes.append((exact(POINT + step) - exact(POINT - step)) / (2 * h * POINT[i]))
        wanted.append(float((4 * slopes[1] - slopes[0]) / 3))
    return wanted


def median_seconds(function):
    jax.block_until_ready(function(POINT))
    taken = []
    for _ in range(TURNS):
        begin = time.perf_counter()
        jax.block_until_ready(function(POINT))
        taken.append(time.perf_counter() - begin)
    return float(np.median(taken))


def measured(name, seconds, rtol, wanted):
    """One row: what a value costs at this tolerance, its derivatives beside it, and how far these are off."""

    def of_position(x):
        return height(x, seconds, rtol)[0]

    value = jax.jit(lambda x: height(x, seconds, rtol))
    both = jax.jit(jax.jacfwd(of_position))
    one = jax.jit(lambda x: jax.jvp(of_position, (x,), (jnp.array([1.0, 0.0]),)))
    found = np.asarray(both(POINT))
    of_value = median_seconds(value)
    row = {
        "case": name,
        "rtol": rtol,
        "steps": int(value(POINT)[1]),
        "value_ms": f"{1e3 * of_value:.1f}",
        "jvp_ratio": f"{median_seconds(one) / of_value:.2f}",
        "jacfwd_2_ratio": f"{median_seconds(both) / of_value:.2f}",
    }
    for i, label in enumerate(("viscosity", "clearance")):
        row[f"error_by_{label}"] = f"{abs(found[i] / wanted[i] - 1):.1e}"
    return row


def main() -> None:
    rows = []
    for name, seconds in CASES.items():
        wanted = derivatives_by_differences(seconds)
        rows += [measured(name, seconds, rtol, wanted) for rtol in RTOLS]
    write("film_gradient", "python benchmarks/film_gradient.py", rows)


if __name__ == "__main__":
    main()
