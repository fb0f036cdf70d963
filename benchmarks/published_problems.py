"""Problems that others published: error and processor time, as the IFToMM library reports them.

    python benchmarks/published_problems.py

One row a problem and tolerance. The measure is the problem's own: the distance from printed digits or a closed form, or
the change of mechanical energy. Seconds are processor time of a compiled call on one core (the smallest of five);
compiling it, which depends on the size of the mechanism and takes up to a minute, is in a column of its own.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

from machine import use_one_core, write

use_one_core()

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.integrate import solve_ivp  # noqa: E402
from scipy.special import ellipj, ellipk  # noqa: E402

import spherejax as sj  # noqa: E402

G = 9.81
REPEATS = 5


class Problem(NamedTuple):
    """A published problem.

    Attributes:
        name: scene and its number, if it has one.
        scene: the scene.
        duration: of the motion [s].
        measure: what the error is, in words.
        error: its value from a run with `SAMPLES` samples.
        tolerances: at which it is run.
    """

    name: str
    scene: Callable[[], sj.Scene]
    duration: float
    measure: str
    error: Callable[[sj.Trajectory], float]
    tolerances: tuple[float, ...]


SAMPLES = 101


def energy_change(run: sj.Trajectory) -> float:
    """Largest change of the mechanical energy at the samples [J]."""
    energy = np.asarray(run.mechanical_energy)
    return float(np.abs(energy - energy[0]).max())


def pendulum_error(run: sj.Trajectory) -> float:
    """Largest distance of the bob from the elliptic function [m]."""
    sn, _, _, _ = ellipj(ellipk(0.5) + np.sqrt(G) * np.asarray(run.ts), 0.5)
    angle = 2 * np.arcsin(np.sqrt(0.5) * sn)
    expected = np.stack([-np.sin(angle), -np.cos(angle), 0 * angle], 1)
    return float(np.abs(np.asarray(run.position("bob")) - expected).max())


def four_bar_error(run: sj.Trajectory) -> float:
    """Largest distance of a rod's center from the pendulum that the mechanism is [m]."""

    def rate(_, y):
        return [y[1], 3.5 / 3 * G * np.sin(y[0])]

    ts = np.asarray(run.ts)
    angle = solve_ivp(rate, (0, ts[-1]), [0, 1], "DOP853", ts, rtol=1e-13, atol=1e-13).y[0]
    return float(np.abs(np.asarray(run.position("rod_00"))[:, 0] - 0.5 * np.sin(angle)).max())


def andrews_error(run: sj.Trajectory) -> float:
    """Largest relative error of the seven angles at the end against the 16 digits of the test set."""
    printed = np.array(
        [15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948, 0.5244099658805304,
         0.5347301163226948, 1.048080741042263]
    )  # fmt: skip
    last = (np.asarray(run.quaternion(f"k{i}"))[-1] for i in range(1, 8))
    k1, k2, k3, k4, k5, k6, k7 = (2 * np.arctan2(q[3], q[0]) for q in last)
    difference = np.array([k1, k2 - k1, k3, k4 - k5, k5, k6 - k7, k7]) - printed
    return float(np.abs((difference - 2 * np.pi * np.round(difference / (2 * np.pi))) / printed).max())


def car_axis_error(run: sj.Trajectory) -> float:
    """Largest relative error of the masses' places at the end against the digits of the test set."""
    printed = np.array([0.493455784275402809e-1, 0.496989460230171154, 0.104174252488542152e1, 0.373911027265361257])
    found = np.concatenate([np.asarray(run.position(mass))[-1, :2] for mass in ("left", "right")])
    return float(np.abs(found / printed - 1).max())


def against_tight(scene: Callable[[], sj.Scene], body: str) -> Callable[[sj.Trajectory], float]:
    """Largest distance of a body from a run by another method at a tighter tolerance [m]."""

    def error(run: sj.Trajectory) -> float:
        other = sj.simulate(scene(), run.ts, rtol=1e-10, solver=sj.Rodas5P()).require_success()
        return float(np.abs(np.asarray(run.position(body)) - np.asarray(other.position(body))).max())

    return error


governor_error = against_tight(sj.gallery.governor, "slider")
THREE = (1e-6, 1e-8, 1e-10)
SCENES = sj.gallery

PROBLEMS = (
    Problem("A01 simple pendulum", SCENES.simple_pendulum, 10.0, "position [m]", pendulum_error, THREE),
    Problem("A02 two four-bars", SCENES.n_four_bar, 10.0, "energy [J]", energy_change, THREE),
    Problem("A02 two four-bars", SCENES.n_four_bar, 10.0, "position [m]", four_bar_error, THREE),
    Problem("A04 Bricard", SCENES.bricard, 10.0, "energy [J]", energy_change, THREE),
    Problem(
        "A05 governor", SCENES.governor, 10.0, "slider [m]", against_tight(SCENES.governor, "slider"), (1e-6, 1e-8)
    ),
    Problem("Andrews' squeezer", SCENES.andrews, 0.03, "relative, angles", andrews_error, THREE),
    Problem("car axis", SCENES.car_axis, 3.0, "relative, places", car_axis_error, THREE),
    Problem("heavy top", SCENES.heavy_top, 1.0, "energy [J]", energy_change, THREE),
    Problem("slider-crank", SCENES.slider_crank, 10.0, "energy [J]", energy_change, THREE),
)


def rows_of(problem: Problem, compiled: dict) -> list[dict[str, object]]:
    """A row for each tolerance; a scene that was compiled for another measure is not compiled again."""
    if problem.scene not in compiled:
        compiled[problem.scene] = _compiled(problem)
    run, compile_seconds = compiled[problem.scene]
    rows = []
    for rtol in problem.tolerances:
        motion, seconds = _fastest(lambda rtol=rtol: run(rtol))
        rows.append(
            {
                "problem": problem.name,
                "duration_s": f"{problem.duration:g}",
                "measure": problem.measure,
                "rtol": f"{rtol:.0e}",
                "error": f"{problem.error(motion.require_success()):.1e}",
                "cpu_seconds": f"{seconds:.5f}",
                "steps": int(motion.stats.n_steps),
                "method": motion.choice.split(":")[0],
                "drift_control": type(motion.system.drift).__name__,
                "compile_cpu_seconds": f"{compile_seconds:.1f}",
            }
        )
        print(rows[-1], flush=True)
    return rows


def _compiled(problem: Problem):
    ts = jnp.linspace(0.0, problem.duration, SAMPLES)
    run = jax.jit(lambda rtol: sj.simulate(problem.scene(), ts, rtol=rtol))
    begin = time.process_time()
    jax.block_until_ready(run(problem.tolerances[0]).ys)
    return run, time.process_time() - begin


def _fastest(call):
    seconds = []
    motion = call()
    for _ in range(REPEATS):
        begin = time.process_time()
        motion = jax.block_until_ready(call())
        seconds.append(time.process_time() - begin)
    return motion, min(seconds)


def main() -> None:
    compiled: dict = {}
    rows = [row for problem in PROBLEMS for row in rows_of(problem, compiled)]
    write("published_problems", "python benchmarks/published_problems.py", rows)


if __name__ == "__main__":
    main()
