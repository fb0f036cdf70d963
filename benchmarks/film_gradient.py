"""Derivatives of the lubricated four-bar by viscosity and clearance: how exact, and what they cost.

    python benchmarks/film_gradient.py     # about ten minutes, most of it compiling

Forward sensitivities at rtol 1e-8, 1e-9 and 1e-10 against central differences of runs at 1e-12, with the tolerance of
derivatives that `sj.simulate` has by itself and with that of explicit methods (twice `rtol`). Times are the shortest of
seven by turns, in units of the value's at the same rtol, and at 1e-8. Duration and tolerances are traced: there are
three programs in all.
"""

from machine import shortest_by_turns, use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402

CASES = {"0.2 s": 0.2, "2 s": 2.0}
ASKED = ((1e-8, 1e3), (1e-8, 2.0), (1e-9, 1e3), (1e-10, 1e3))
"""Tolerance, and that of derivatives in units of it."""
POINT = jnp.array([0.4, 1e-4])
TURNS = 7
SHIFT = 1e-4
"""Of the differences, relative."""


def height(numbers, seconds, rtol, factor):
    """The rocker's last height [m], and the steps of the run."""
    viscosity, clearance = numbers
    scene = sj.gallery.four_bar(sj.Lubricated(clearance, viscosity=viscosity))
    ts = jnp.stack([jnp.zeros(()), seconds])
    run = sj.simulate(scene, ts, rtol=rtol, derivative_rtol=factor * rtol)
    return run.position("rocker")[-1, 2], run.stats.n_steps


def of_position(numbers, *how):
    """The height alone."""
    return height(numbers, *how)[0]


VALUE = jax.jit(height)
BOTH = jax.jit(jax.jacfwd(of_position))
ONE = jax.jit(lambda x, *how: jax.jvp(lambda x: of_position(x, *how), (x,), (jnp.array([1.0, 0.0]),)))


def derivatives_by_differences(seconds):
    """Of runs at 1e-12, with two shifts and Richardson's rule: their error falls to the fourth order."""

    def exact(x):
        return VALUE(x, seconds, 1e-12, 1.0)[0]

    wanted = []
    for i in range(2):
        slopes = []
        for h in (SHIFT, SHIFT / 2):
            step = h * POINT[i] * jnp.eye(2)[i]
            slopes.append((exact(POINT + step) - exact(POINT - step)) / (2 * h * POINT[i]))
        wanted.append(float((4 * slopes[1] - slopes[0]) / 3))
    return wanted


def measured(name, seconds, rtol, factor, wanted):
    """One row: what a value costs at this tolerance, its derivatives beside it, and how far these are off."""
    how = seconds, rtol, factor
    calls = ((VALUE, (seconds, 1e-8, 1e3)), (VALUE, how), (ONE, how), (BOTH, how))
    usual, own, one, both = shortest_by_turns(
        [lambda program=program, how=how: jax.block_until_ready(program(POINT, *how)) for program, how in calls],
        TURNS,
    )
    found = np.asarray(BOTH(POINT, *how))
    row = {
        "case": name,
        "rtol": rtol,
        "derivative_rtol": rtol * factor,
        "steps": int(VALUE(POINT, *how)[1]),
        "value_ms": f"{1e3 * own:.1f}",
        "jvp_by_one": f"{one / own:.2f}",
        "jacfwd_by_2": f"{both / own:.2f}",
        "jacfwd_by_2_of_value_at_1e-8": f"{both / usual:.2f}",
    }
    for i, label in enumerate(("viscosity", "clearance")):
        row[f"error_by_{label}"] = f"{abs(found[i] / wanted[i] - 1):.1e}"
    return row


def main() -> None:
    """Print the table and write it."""
    rows = []
    for name, seconds in CASES.items():
        wanted = derivatives_by_differences(seconds)
        for rtol, factor in ASKED:
            rows.append(measured(name, seconds, rtol, factor, wanted))
            print(rows[-1], flush=True)
    write("film_gradient", "python benchmarks/film_gradient.py", rows)


if __name__ == "__main__":
    main()
