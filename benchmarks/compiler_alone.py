"""The compiler without mechanics: `scalarize(f)` in front of a plain `f(t, y, args)`, integrated by plain diffrax.

    python benchmarks/compiler_alone.py            # a minute
    python benchmarks/compiler_alone.py --check    # a few steps, results compared; no times

Each problem is integrated three times, with the same solver, tolerances and steps: the function as it is, its scalar
program, and the scalar program within `native_code`, which makes machine code of programs from
`primitive.SMALLEST_CALLED` operations on. Times are the least of several calls of compiled
functions, by turns.
"""

import argparse
from collections.abc import Callable
from functools import partial

from machine import shortest_by_turns, use_one_core, write

use_one_core()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402

import spherejax  # noqa: E402, F401 - sets XLA's flags and 64-bit numbers; the compiler itself needs nothing of it
from spherejax.compiler import native_code, scalarize  # noqa: E402


def lorenz(t, y, args):
    """The Lorenz system."""
    del t
    sigma, rho, beta = args
    return jnp.stack([sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]])


def three_bodies(t, y, args):
    """Three masses in a plane that attract each other; positions, then velocities."""
    del t
    positions, velocities = y[:6].reshape(3, 2), y[6:]
    apart = positions[None] - positions[:, None]
    squares = jnp.sum(apart**2, -1) + jnp.eye(3)  # no division by zero on the diagonal, where nothing attracts
    pulls = args[None, :, None] * apart / squares[..., None] ** 1.5
    return jnp.concatenate([velocities, jnp.sum(pulls, 1).ravel()])


SPECIES, REACTIONS = 20, 40


def network() -> tuple[np.ndarray, np.ndarray]:
    """A chemical network: of each reaction, the two species that react and the stoichiometry of all."""
    random = np.random.default_rng(7)
    reactants = np.array([random.choice(SPECIES, 2, replace=False) for _ in range(REACTIONS)])
    products = np.array([random.choice(SPECIES, 2, replace=False) for _ in range(REACTIONS)])
    stoichiometry = np.zeros((SPECIES, REACTIONS))
    for i in range(REACTIONS):
        stoichiometry[reactants[i], i] -= 1.0
        stoichiometry[products[i], i] += 1.0
    return reactants, stoichiometry


REACTANTS, STOICHIOMETRY = network()


def chemistry(t, y, args):
    """Mass action: the rate of a reaction is its constant times both concentrations."""
    del t
    rates = args * y[REACTANTS[:, 0]] * y[REACTANTS[:, 1]]
    return jnp.asarray(STOICHIOMETRY) @ rates


def problems() -> dict[str, tuple[Callable, np.ndarray, np.ndarray, float]]:
    """By name: the function, the start, the arguments, and the end of the time span."""
    figure_eight = np.array([
        0.97000436, -0.24308753, -0.97000436, 0.24308753, 0.0, 0.0,
        0.466203685, 0.43236573, 0.466203685, 0.43236573, -0.93240737, -0.86473146,
    ])  # fmt: skip
    random = np.random.default_rng(3)
    return {
        "Lorenz": (lorenz, np.array([1.0, 1.0, 1.0]), np.array([10.0, 28.0, 8.0 / 3.0]), 50.0),
        "three bodies": (three_bodies, figure_eight, np.ones(3), 100.0),
        "20 species": (chemistry, random.uniform(0.1, 1.0, SPECIES), random.uniform(0.1, 10.0, REACTIONS), 50.0),
    }


def integrated(function: Callable, t1: float) -> Callable:
    """A function (y0, args) -> (state at the end, number of steps), by plain diffrax."""
    controller = diffrax.PIDController(rtol=1e-9, atol=1e-9)

    def run(y0, args):
        term = diffrax.ODETerm(function)
        solution = diffrax.diffeqsolve(
            term, diffrax.Dopri8(), 0.0, t1, 1e-3, y0, args, stepsize_controller=controller, max_steps=100_000,
            adjoint=diffrax.ForwardMode(),
        )  # fmt: skip
        assert solution.ys is not None
        return solution.ys[-1], solution.stats["num_steps"]

    return run


def variants(function: Callable, y0: np.ndarray, args: np.ndarray, t1: float) -> dict[str, Callable]:
    """The same integration of the function as it is, of its scalar program, and of that as machine code."""
    program = scalarize(function, 0.0, y0, args)
    return {
        "plain": jax.jit(integrated(function, t1)),
        "scalar program": jax.jit(integrated(program, t1)),
        # As a decorator: the loop of diffrax becomes machine code with what it calls.
        "machine code": jax.jit(native_code()(integrated(program, t1))),
    }


def _finished(run: Callable, *arguments):
    return jax.block_until_ready(run(*arguments))


def main() -> None:
    """Measure, or check."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--check", action="store_true", help="short runs, results compared, no times")
    is_check = parser.parse_args().check
    rows = []
    for name, (function, y0, args, t1) in problems().items():
        runs = variants(function, y0, args, t1 / 100 if is_check else t1)
        calls = [partial(_finished, run, y0, args) for run in runs.values()]
        results = [call() for call in calls]
        if is_check:  # in a short time not even the Lorenz system makes much of a rounding
            for end, n_steps in results:
                np.testing.assert_allclose(end, results[0][0], rtol=1e-7, atol=1e-9)
                assert n_steps == results[0][1]
            continue
        row = {"problem": name}
        for how, seconds, (_, n_steps) in zip(runs, shortest_by_turns(calls), results, strict=True):
            row[f"{how.replace(' ', '_')}_us_a_step"] = f"{1e6 * seconds / int(n_steps):.2f}"
        rows.append(row)
    if rows:
        write("compiler_alone", "python benchmarks/compiler_alone.py", rows)


if __name__ == "__main__":
    main()
