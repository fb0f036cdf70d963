"""What is left of the cost, in one run on one machine: derivatives, traced numbers, first calls, runs, sweeps.

    pip install numba                          # the hand-written program that runs are compared with
    python benchmarks/cost_goals.py            # about ten minutes, on a quiet machine
    python benchmarks/cost_goals.py derivatives stiffness first_calls command runs sweep

Each row has what was measured, the goal, and the arithmetic behind it where there is one: by how many operations and
steps the work differs. First calls are in processor time, in units of the first `diffeqsolve` of the Lorenz system
(`start_up.py`); ratios of runs are of shortest times by turns (`composing.py`); runs are compared with the numba
program at equal achieved error (`against_others.py`, `sweeps.py`).
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import composing
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import start_up
from machine import shortest_by_turns, write
from operations import lines_of, n_evaluated

import spherejax as sj

rows: list[dict[str, object]] = []


def add(work: str, measured: float, goal: float, arithmetic: str = "") -> None:
    """A row of the table."""
    rows.append(
        {
            "work": work,
            "measured": f"{measured:.2f}",
            "goal": f"{goal:g}",
            "reached": "yes" if measured <= goal else "no",
            "arithmetic": arithmetic,
        }
    )
    print(rows[-1], flush=True)


def work_of(scene_of: Callable, n_rows: int, numbers: tuple) -> str:
    """How much more is done with rows beside the motion: steps, and operations of a right-hand side with its rows."""
    value, with_coefficients, row = map(n_evaluated, lines_of("the scene", scene_of(*numbers)))
    moved, held = jnp.array(numbers[:n_rows]), numbers[n_rows:]

    def steps(moved):
        run = run_of(scene_of, *moved, *held)
        return run.position("rocker")[-1, 2], run.stats.n_steps

    alone = int(jax.jit(steps)(moved)[1])
    beside = int(jax.jit(lambda x: jax.jvp(steps, (x,), (jnp.ones_like(x),)))(moved)[0][1])
    operations = (with_coefficients + n_rows * row) / value
    return f"{beside} steps for {alone}, {operations:.2f} times the operations each: {beside / alone * operations:.2f}"


def run_of(scene_of: Callable, *numbers):
    """The run of `composing.py`."""
    return sj.simulate(scene_of(*numbers), composing.TS, rtol=composing.RTOL)


def tight(scene_of: Callable) -> Callable:
    """The run of `composing.height` at a far tighter tolerance."""
    return lambda *numbers: sj.simulate(scene_of(*numbers), composing.TS, rtol=1e-12).position("rocker")[-1, 2]


def derivative(of: Callable, at: float):
    """By one number."""
    return jax.jit(lambda x: jax.jvp(of, (x,), (1.0,))[1])(at)


def derivatives() -> None:
    """jvp by one number, jacfwd by three."""
    cases = {"dry": (composing.dry, (1e-4, 0.1, 0.9)), "bushing": (composing.bushing, (1e6, 1e-4))}
    for name, (scene_of, numbers) in cases.items():
        one = composing.height(scene_of)
        coarse = composing.height(scene_of, derivative_rtol=1e-6)
        all_of = composing.height(lambda numbers, scene_of=scene_of: scene_of(*numbers))
        coarse_of = composing.height(lambda numbers, scene_of=scene_of: scene_of(*numbers), derivative_rtol=1e-6)
        first, each = numbers[0], jnp.array(numbers)
        calls = [
            (jax.jit(one), first),
            (jax.jit(lambda x, one=one: jax.jvp(one, (x,), (1.0,))), first),
            (jax.jit(lambda x, one=coarse: jax.jvp(one, (x,), (1.0,))), first),
            (jax.jit(jax.jacfwd(all_of)), each),
            (jax.jit(jax.jacfwd(coarse_of)), each),
        ]
        found = shortest_by_turns([lambda call=call, at=at: jax.block_until_ready(call(at)) for call, at in calls])
        add(f"jvp by one, {name}, in values", found[1] / found[0], 3.0, work_of(scene_of, 1, numbers))
        exact = derivative(tight(scene_of), first)
        off = [abs(float(derivative(by, first) / exact) - 1.0) for by in (one, coarse)]
        rows[-1]["arithmetic"] = f"{rows[-1]['arithmetic']}; error {off[0]:.0e}"
        add(f"jvp by one, {name}, derivative_rtol 1e-6, in values", found[2] / found[0], 3.0, f"error {off[1]:.0e}")
        if len(numbers) == 3:
            add(f"jacfwd by three, {name}, in values", found[3] / found[0], 4.0, work_of(scene_of, 3, numbers))
            add(f"jacfwd by three, {name}, derivative_rtol 1e-6, in values", found[4] / found[0], 4.0)


def stiffness() -> None:
    """A stiff bushing whose stiffness is traced, against a known one."""
    ts = jnp.array([0.0, 2.0])

    def height(stiffness):
        return sj.simulate(composing.bushing(stiffness, 1e-2), ts, rtol=1e-6).position("rocker")[-1, 2]

    traced = jax.jit(height)
    known, unknown = shortest_by_turns(
        [lambda: jax.block_until_ready(height(1e6)), lambda: jax.block_until_ready(traced(1e6))]
    )
    add("traced stiff bushing against known, 2 s, rtol 1e-6", unknown / known, 1.1)


def first_calls() -> None:
    """First calls in units of diffrax's own, and the same from a filled cache, beyond the imports."""
    unit = float(np.median([start_up.printed(start_up.LORENZ, "0") for _ in range(start_up.REPEATS)]))
    goals = {"ideal": 2.0, "dry": 3.0, "film": 4.0, "dry-grad": 5.0, "film-grad": 6.0}
    for name, goal in goals.items():
        what, code, _ = start_up.CALLS[name]
        with tempfile.TemporaryDirectory() as cache:
            first = start_up.printed(code, cache)
            kept = float(np.median([start_up.printed(code, cache) for _ in range(start_up.REPEATS)]))
        add(f"first call, {what}, in U = {unit:.2f} s", first / unit, goal, f"{first:.2f} s")
        add(f"first call, {what}, from a filled cache, s", kept, 0.2)


def command() -> None:
    """The README's main job with empty caches, as after an installation."""
    words = [str(Path(sys.executable).with_name("spherejax")), "compare", "four-bar"]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "SPHEREJAX_CACHE": f"{folder}/cache"}
        begin = time.perf_counter()
        subprocess.run(words, cwd=folder, env=environment, check=True, capture_output=True)
        add("spherejax compare four-bar, empty caches, s", time.perf_counter() - begin, 30.0)


ACCURACIES = (1e-8, 1e-9, 1e-10, 1e-11)
"""Errors of the rocker's height that are asked of runs [m]."""

TOLERANCES = tuple(10.0**-k for k in np.arange(3.0, 11.1, 0.5))


def runs() -> None:
    """A dry run of 0.2 s against the numba program at equal errors, which events make erratic: at four of them."""
    import against_others as others

    methods = dict(others.methods_of(others.CASES["dry_short"]))
    pair = next(method for label, method in methods.items() if "its choice" in label), methods["numba DOP853"]
    reference = pair[1](1e-13).heights
    seconds = np.array(shortest_by_turns([lambda m=m, tol=tol: m(tol) for m in pair for tol in TOLERANCES]))
    errors = [float(np.abs(m(tol).heights - reference).max()) for m in pair for tol in TOLERANCES]
    by_method = [(t, e) for t, e in zip(np.split(seconds, 2), np.split(np.array(errors), 2), strict=True)]
    found = np.array([[min(t[e < accuracy]) for accuracy in ACCURACIES] for t, e in by_method])
    ratios = found[0] / found[1]
    said = ", ".join(
        f"{a * 1e3:.2f} of {b * 1e3:.2f} ms to {e:.0e} m" for a, b, e in zip(*found, ACCURACIES, strict=True)
    )
    add("single dry run of 0.2 s, in numba's", float(np.exp(np.mean(np.log(ratios)))), 0.25, said)


def sweep() -> None:
    """Runs per second and core, in those of the numba program in one process."""
    import sweeps
    from sweep_scenes import N_CORES, N_RUNS

    reference = sweeps.by_hand((1e-12, 0, N_RUNS))
    ours = sweeps.swept(diffrax.Dopri8())
    tolerance, error = sweeps.accurate(ours, reference)
    ours(tolerance)
    busy = float(np.max(ours.results[tolerance].attrs["seconds_of_chunks"]))
    theirs, by_hand_error = sweeps.accurate(lambda tolerance: sweeps.by_hand((tolerance, 0, N_RUNS)), reference)
    begin = time.perf_counter()
    sweeps.by_hand((theirs, 0, N_RUNS))
    alone = time.perf_counter() - begin
    said = (
        f"{N_RUNS / busy / N_CORES:.0f} runs/s a core to {error:.0e} m, {N_RUNS / alone:.0f} to {by_hand_error:.0e} m"
    )
    # More is better here: the table compares what must not be exceeded.
    add("sweep: numba's runs a core in ours", busy * N_CORES / alone, 1 / 7, said)


PARTS = {
    "derivatives": derivatives,
    "stiffness": stiffness,
    "first_calls": first_calls,
    "command": command,
    "runs": runs,
    "sweep": sweep,
}


def main() -> None:
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
    write("cost_goals", "python benchmarks/cost_goals.py", rows, ("numba",))


if __name__ == "__main__":
    main()
