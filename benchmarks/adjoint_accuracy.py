"""Accuracy and error amplification of gradients by all numbers of a scene, in reverse mode.

    python benchmarks/adjoint_accuracy.py               # five minutes
    python benchmarks/adjoint_accuracy.py --factors 5 20 50 --cases "dry with friction" "large clearance"

Height of the rocker of a four-bar. Errors are those of the norm of a gradient, beside the gradient at an rtol of 1e-10;
the amplification is that of `pullback.Gradient`, whose limit of 1 is lifted here. A factor is the tolerance of the
mixture of explicit methods as a multiple of the state's (`pullback.FACTOR_ELSEWHERE`). Times are those of a call under
`jax.jit` at the last tolerance; results are printed.
"""

import argparse
import math
import os
import time

os.environ["SPHEREJAX_CACHE"] = "off"  # stored programs have the usual limit and factor

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np

import spherejax as sj
from spherejax.foundations.checks import is_concrete
from spherejax.motion.derivatives import pullback

CASES = {
    "bushing, b = 100 s": (sj.Bushing(1e6, 100.0), 0.1),
    "bushing, b = 0.01 s": (sj.Bushing(1e6, 1e-2), 0.1),
    "dry with friction": (sj.Dry(1e-4, friction=sj.Threlfall()), 0.2),
    "large clearance": (sj.Dry(5e-4, friction=sj.Threlfall()), 0.3),
    "lubricated": (sj.Lubricated(1e-4, viscosity=0.4), 0.2),
}
"""Joint models, and ends of the runs [s]."""

TOLERANCES = (1e-6, 1e-7, 1e-8)


def gradient_of(model, end: float):
    """The gradient as a function (numbers, rtol), and the numbers; the exponent of a contact is held fixed."""
    scene = sj.gallery.four_bar(model)
    numbers, rest = eqx.partition(scene, eqx.is_inexact_array)
    flat, unflatten = jax.flatten_util.ravel_pytree(numbers)

    def height(flat, rtol):
        whole = eqx.combine(unflatten(flat), rest)
        if isinstance(model, sj.Dry):
            whole = eqx.tree_at(exponent_of, whole, exponent_of(scene))
        return sj.simulate(whole, jnp.linspace(0.0, end, 5), rtol=rtol).position("rocker")[-1, 2]

    return jax.grad(height), flat


def exponent_of(scene):
    return scene.joints["coupler_rocker"].model.normal.exponent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--factors", nargs="+", type=float, default=[pullback.FACTOR_ELSEWHERE])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    options = parser.parse_args()
    pullback.LARGEST_AMPLIFICATION = math.inf
    seen = []

    def note(self, stacklevel=2):
        if is_concrete(self.amplification):
            seen.append(float(self.amplification))

    pullback.Gradient.warn = note
    for case in options.cases:
        gradient, at = gradient_of(*CASES[case])
        for factor in options.factors:
            pullback.FACTOR_ELSEWHERE = factor
            pullback.pulled_back.clear()
            exact = np.asarray(gradient(at, 1e-10))
            for rtol in TOLERANCES:
                error = np.linalg.norm(gradient(at, rtol) - exact) / np.linalg.norm(exact)
                print(f"{case}, factor {factor:g}, rtol {rtol:g}: error {error:.1e}, amplification {seen[-1]:.1e}")
            timed = jax.jit(
                lambda at, gradient=gradient: gradient(at, TOLERANCES[-1])
            )  # traced anew: the factor changed
            print(f"  {1e3 * shortest(timed, at):.0f} ms", flush=True)


def shortest(function, *arguments) -> float:
    """Shortest time of twenty calls [s], the first one not counted."""
    times = []
    for _ in range(21):
        begin = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        times.append(time.perf_counter() - begin)
    return min(times[1:])


if __name__ == "__main__":
    main()
