"""What it costs that every run audits itself: the same runs with and without, in turns.

    python benchmarks/audit_price.py            # six minutes

Energy, flight, constraints and quaternions are looked at at the end of every step
(`spherejax.motion.integration.audit`). There is no switch for it; here the function that makes it is replaced. Calls
are compiled by `jax.jit`, so both are traced anew.
Two programs that do the same differ by up to 4 % by where they come to lie in memory, so each pair is compiled five
times: the ratio is the median of the five, with the lowest and the highest beside it.
"""

import os

os.environ["SPHEREJAX_CACHE"] = "0"  # a program with a replaced function must not be taken for another

import time
from unittest import mock

from machine import use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax as sj  # noqa: E402

TURNS = 15
COMPILED = 5


def run(duration, model_of):
    """A run by one number, to the rocker's height."""

    def height(number):
        motion = sj.simulate(sj.gallery.four_bar(model_of(number)), jnp.array([0.0, duration]))
        return motion.position("rocker")[-1, 2], motion.stats.n_steps

    return height


def dry(clearance):
    return sj.Dry(clearance, friction=sj.Threlfall())


CASES = {
    "ideal, 2 s": (run(2.0, lambda x: sj.Ideal()), 1.0),
    "bushing k 1e6 b 1e-4, 2 s": (run(2.0, lambda k: sj.Bushing(k, 1e-4)), 1e6),
    "dry with friction, 1 s": (run(1.0, dry), 1e-4),
    "lubricated, 0.2 s": (run(0.2, lambda c: sj.Lubricated(c, viscosity=0.4)), 1e-4),
    "64 lanes, dry with friction, 0.2 s": (jax.vmap(run(0.2, dry)), jnp.linspace(5e-5, 2e-4, 64)),
}


def seconds(function, number) -> float:
    begin = time.perf_counter()
    jax.block_until_ready(function(number))
    return time.perf_counter() - begin


def turns(function, number):
    """Seconds with and without audit in turns, and the steps; both compiled anew."""
    with_audit, without = (jax.jit(lambda x, function=function: function(x)) for _ in range(2))
    steps = with_audit(number)[1]
    with mock.patch("spherejax.motion.integration.jobs.audit_of", return_value=None):
        assert np.array_equal(without(number)[1], steps)
    return np.array([[seconds(each, number) for each in (with_audit, without)] for _ in range(TURNS)]), steps


def main() -> None:
    rows = []
    for name, (function, number) in CASES.items():
        pairs, steps = zip(*(turns(function, number) for _ in range(COMPILED)), strict=True)
        ratios = sorted(float(np.median(each[:, 0] / each[:, 1])) for each in pairs)
        audited, bare = 1e3 * np.median(np.concatenate(pairs), axis=0)
        rows.append({
            "case": name,
            "milliseconds": f"{audited:.2f}",
            "without_audit": f"{bare:.2f}",
            "ratio": f"{float(np.median(ratios)):.3f}",
            "lowest": f"{ratios[0]:.3f}",
            "highest": f"{ratios[-1]:.3f}",
            "steps": int(np.sum(steps[0])),
        })  # fmt: skip
    write("audit_price", "python benchmarks/audit_price.py", rows)


if __name__ == "__main__":
    main()
