"""The automatic choice of method on a parallel mechanism, controllers and films: how far from the best at equal error?

    python benchmarks/automatic_mechanisms.py                   # all cases
    python benchmarks/automatic_mechanisms.py "Stewart platform, dry with friction"

A Stewart platform of 13 bodies (six legs of cylinder and rod, a PID controller along each, one joint that is not ideal)
for 0.1 s, and the four-bar with a film and a controlled crank for 0.05 s. A row is a method at a tolerance. The error
is the largest of a body's positions at 5 samples against a run by Dopri8 at rtol 1e-11. Times are processor times of a
compiled run, the least of three: they hold on a machine that does other work as well, within a fifth.

`ratio_at_equal_error` compares each run with the cheapest way, by any of the methods, to an error that is no larger:
between two tolerances of one method the logarithm of the time is interpolated over that of the error.
"""

import shlex
import sys
import time
import warnings

from machine import use_one_core, write

use_one_core()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from stewart import stewart_platform  # noqa: E402

import spherejax as sj  # noqa: E402
from spherejax.model.system import compile_scene  # noqa: E402
from spherejax.motion.solvers.automatic import choose_solver  # noqa: E402

METHODS = {
    "Dopri8": diffrax.Dopri8(),
    "Tsit5": diffrax.Tsit5(),
    "Rodas5P": sj.solvers.Rodas5P(),
    "Ros34PW2": sj.solvers.Ros34PW2(),
}
RTOLS = (1e-4, 1e-6, 1e-8)
MAX_STEPS = 100_000
LONGEST = 60.0
"""Processor time [s] of a run beyond which it is not repeated, and not made at a tighter tolerance."""
ROUNDING = 1e-13
"""Errors [m] below this count as this."""


def controlled_four_bar(model: sj.joints.AbstractSphericalModel) -> sj.Scene:
    """The four-bar with a PID controller at its crank."""
    scene = sj.gallery.four_bar(model)
    turn = sj.Turn(("ground", "crank"), axis=(0.0, 1.0, 0.0))
    motor = sj.PID(turn, 0.0, proportional=10.0, derivative=1.0, filter_time=1e-3)
    return sj.Scene(scene.bodies, scene.joints, {"motor": motor}, ground_points=scene.ground_points)


DRY = sj.Dry(1e-4, friction=sj.Threlfall(mu=0.1, v1=1e-3))
CASES = {
    "Stewart platform, dry with friction": (lambda: stewart_platform(DRY), "platform", 0.1),
    "Stewart platform, bushing 1e6 N/m": (lambda: stewart_platform(sj.Bushing(1e6, 1e-3)), "platform", 0.1),
    "Stewart platform, film": (lambda: stewart_platform(sj.Lubricated(1e-4, viscosity=0.04)), "platform", 0.02),
    "four-bar, film and PID": (lambda: controlled_four_bar(sj.Lubricated(1e-4)), "rocker", 0.05),
    "four-bar, dry and PID": (lambda: controlled_four_bar(DRY), "rocker", 0.05),
    "four-bar, film 0.2 mm": (lambda: sj.gallery.four_bar(sj.Lubricated(2e-4)), "rocker", 0.05),
}


def run_of(scene, body: str, t1: float, rtol: float, method):
    """The least processor time [s] of three runs, their steps, and the positions; None where a run fails."""
    ts, seconds = jnp.linspace(0.0, t1, 5), []
    for repeat in range(4):  # the first compiles
        begin = time.process_time()
        run = sj.simulate(scene, ts, rtol=rtol, solver=method, max_steps=MAX_STEPS)
        positions = np.asarray(jax.block_until_ready(run.position(body)))
        seconds.append(time.process_time() - begin)
        if not run.succeeded or (repeat and seconds[-1] > LONGEST / 10):
            break
    return (min(seconds[1:], default=seconds[0]), int(run.stats.n_steps), positions) if run.succeeded else None


def cheapest(found: dict[float, tuple[float, float]], error: float) -> float:
    """The time at which a method reaches an error, by its (time, error) at some tolerances; infinite beyond them."""
    points = sorted(((max(e, ROUNDING), seconds) for seconds, e in found.values()))
    times = [seconds for e, seconds in points if e <= error]
    if points and points[0][0] < error < points[-1][0]:
        errors, seconds = np.log(np.array(points)).T
        times.append(float(np.exp(np.interp(np.log(error), errors, seconds))))
    return min(times, default=np.inf)


def rows_of(case: str, build, body: str, t1: float):
    """A row for each method and tolerance."""
    warnings.simplefilter("ignore", sj.SimulationWarning)
    scene = build()
    reference = run_of(scene, body, t1, 1e-11, diffrax.Dopri8())
    assert reference is not None, f"{case}: no reference"
    rows, found = [], {name: {} for name in METHODS}
    system = compile_scene(scene).system
    chosen = {rtol: type(choose_solver(system, rtol).solver).__name__ for rtol in RTOLS}
    for name, method in METHODS.items():
        for rtol in RTOLS:
            outcome = run_of(scene, body, t1, rtol, method)
            row = {"case": case, "rtol": f"{rtol:.0e}", "method": name}
            if outcome is not None:
                seconds, steps, positions = outcome
                error = float(np.max(np.abs(positions - reference[2])))
                found[name][rtol] = seconds, error
                row |= {"processor_ms": f"{1e3 * seconds:.3g}", "steps": steps, "error_m": f"{error:.1e}"}
            rows.append({"processor_ms": "", "steps": "", "error_m": "", **row, "chosen": ""})
            print(rows[-1], flush=True)
            if outcome is not None and outcome[0] > LONGEST:
                break
    return judged(rows, found, chosen)


def judged(
    rows: list[dict], found: dict[str, dict[float, tuple[float, float]]], chosen: dict[float, str]
) -> list[dict]:
    """The rows, with the choice at each tolerance and the ratio to the best at equal error."""
    for row in rows:
        rtol = float(row["rtol"])
        row["chosen"] = "yes" if chosen[rtol] == row["method"] else ""
        row["ratio_at_equal_error"] = ""
        if rtol in found[row["method"]]:
            seconds, error = found[row["method"]][rtol]
            best = min(cheapest(runs, max(error, ROUNDING)) for runs in found.values())
            row["ratio_at_equal_error"] = f"{seconds / best:.2f}"
    return rows


def main(titles) -> None:
    rows = [row for case, what in CASES.items() if not titles or case in titles for row in rows_of(case, *what)]
    columns = ("case", "rtol", "method", "processor_ms", "steps", "error_m", "chosen", "ratio_at_equal_error")
    rows = [{column: row[column] for column in columns} for row in rows]
    write("automatic_mechanisms", shlex.join(["python", "benchmarks/automatic_mechanisms.py", *titles]), rows)
    chosen = [row for row in rows if row["chosen"] and row["ratio_at_equal_error"]]
    worst = max(chosen, key=lambda row: float(row["ratio_at_equal_error"]))
    print(f"worst of the choices: {worst['ratio_at_equal_error']} times the best, {worst['case']} at {worst['rtol']}")


if __name__ == "__main__":
    main(sys.argv[1:])
