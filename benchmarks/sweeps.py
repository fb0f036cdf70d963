"""Sweeps: runs per second on all cores against what else one would do, steps, lane efficiency, cost per job, memory.

    python benchmarks/sweeps.py                 # about 20 minutes
    python benchmarks/sweeps.py throughput      # throughput, steps, widths, jobs, killed, sensitivities, exudyn, gpu

Throughput: 1,000 four-bars with dry friction, clearances 0.05 to 0.2 mm, 0.2 s. Every method runs at the loosest
tolerance of its list with which the worst of 1,000 final heights is within 1e-9 m of the hand-written DOP853 at 1e-12.
The competitor is that DOP853 in one process per core; needs the extra `benchmarks`.
"""

import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from itertools import pairwise
from multiprocessing import get_context

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from machine import write
from sweep_exudyn import exudyn
from sweep_jobs import jobs, killed
from sweep_lanes import gpu
from sweep_scenes import CLEARANCES, DURATION, N_CORES, N_RUNS, dry, elastic, film, model_of
from sweep_sensitivities import KEPT, PARAMETERS, runs_of, sensitivities
from sweep_sensitivities import dry as dry_of_three

import spherejax as sj

ACCURACY = 1e-9
TOLERANCES = (1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 1e-9)
HEIGHT = 16
REPEATS = 3

# What else one would do ----------------------------------------------------------------------------------------------


@lru_cache(maxsize=1)
def _hand_written():
    from baselines.dop853 import integrator
    from baselines.parameters import problem

    problems = [problem(model_of(float(clearance))) for clearance in CLEARANCES]
    return integrator("dry"), problems


def by_hand(part: tuple[float, int, int]) -> np.ndarray:
    """Final heights of some runs by the hand-written DOP853."""
    tolerance, first, last = part
    run, problems = _hand_written()
    heights, ys, ts = [], np.empty((2, problems[0].y0.size)), np.array([0.0, DURATION])
    for each in problems[first:last]:
        run(each.y0, ts, tolerance, tolerance * 1e-3, each.parameters, ys)
        heights.append(ys[-1, HEIGHT])
    return np.array(heights)


def hand_written_pool(pool: ProcessPoolExecutor):
    """One process per core, which keeps its compiled code; parts small enough that no core waits for long."""
    bounds = np.linspace(0, N_RUNS, 8 * N_CORES + 1).astype(int)

    def heights(tolerance: float) -> np.ndarray:
        parts = [(tolerance, int(a), int(b)) for a, b in pairwise(bounds)]
        return np.concatenate(list(pool.map(by_hand, parts)))

    return heights


def swept(solver):
    """`sj.sweep` on all cores."""
    compiled = {}

    def heights(tolerance: float) -> np.ndarray:
        result = sj.sweep(
            dry, {"clearance": CLEARANCES}, [0.0, DURATION], record=["final position.rocker"], rtol=tolerance,
            solver=solver, progress=False,
        )  # fmt: skip
        compiled[tolerance] = result
        return result["final_position.rocker"].sel(axis="z").values

    heights.results = compiled
    return heights


def mapped(width: int = 64):
    """`jax.vmap(simulate)`, blocks of runs one after the other, on all cores."""
    from concurrent.futures import ThreadPoolExecutor

    @jax.jit
    def block(tolerance, clearances):
        def height(clearance):
            run = sj.simulate(dry(clearance), jnp.array([0.0, DURATION]), rtol=tolerance)
            return run.position("rocker")[-1, 2]

        return jax.vmap(height)(clearances)

    def heights(tolerance: float) -> np.ndarray:
        padded = np.pad(CLEARANCES, (0, -N_RUNS % width), mode="edge").reshape(-1, width)
        with ThreadPoolExecutor(N_CORES) as pool:
            found = list(pool.map(lambda part: np.asarray(block(tolerance, part)), padded))
        return np.concatenate(found)[:N_RUNS]

    return heights


def accurate(heights, reference) -> tuple[float, float]:
    """The loosest tolerance that reaches the accuracy, and its worst error."""
    for tolerance in TOLERANCES:
        error = float(np.abs(heights(tolerance) - reference).max())
        if error < ACCURACY:
            break
    return tolerance, error


def throughput() -> None:
    rows = []
    with ProcessPoolExecutor(N_CORES, mp_context=get_context("spawn")) as pool:
        by_pool = hand_written_pool(pool)
        reference = by_pool(1e-12)
        methods = {
            "numba DOP853, a process per core": by_pool,
            "sj.sweep, Dopri8": swept(diffrax.Dopri8()),
            "sj.sweep, Tsit5": swept(diffrax.Tsit5()),
            "jax.vmap(simulate), 64 at a time": mapped(),
        }
        for name, heights in methods.items():
            tolerance, error = accurate(heights, reference)
            seconds = []
            for _ in range(REPEATS):
                begin = time.perf_counter()
                heights(tolerance)
                seconds.append(time.perf_counter() - begin)
            taken = float(np.median(seconds))
            if hasattr(heights, "results"):
                # A call of `sj.sweep` traces its program again; the runs themselves are in the chunks.
                result = heights.results[tolerance]
                busy = float(np.max(result.attrs["seconds_of_chunks"]))
                rows.append(_row(name, tolerance, error, busy, result.attrs["lane_efficiency"], taken))
            else:
                rows.append(_row(name, tolerance, error, taken, None, taken))
    write("sweep_throughput", "python benchmarks/sweeps.py throughput", rows, ("numba",))


def _row(name, tolerance, error, seconds, efficiency, whole) -> dict:
    return {
        "method": name,
        "cores": N_CORES,
        "rtol": f"{tolerance:.0e}",
        "worst_error_m": f"{error:.1e}",
        "runs_per_second": f"{N_RUNS / seconds:.0f}",
        "lane_efficiency": "" if efficiency is None else f"{efficiency:.3f}",
        "whole_call_s": f"{whole:.2f}",
    }


# Steps -------------------------------------------------------------------------------------------------------------


def steps() -> None:
    """Microseconds per useful step and core, and lane efficiency, by width of the block."""
    rows = []
    for solver in (diffrax.Tsit5(), diffrax.Dopri8()):
        for width in (8, 16, 24, 32, 64, 128):
            block = sj.solvers.Block(width)
            result = sj.sweep(
                dry, {"clearance": CLEARANCES}, [0.0, DURATION], record=["final position.rocker"], rtol=1e-6,
                solver=solver, block=block, workers=1, chunk=N_RUNS // 2, progress=False,
            )  # fmt: skip
            seconds = float(np.min(result.attrs["seconds_of_chunks"]))
            n_steps = int(result["n_steps"].sum()) / 2
            rows.append(
                {
                    "method": type(solver).__name__,
                    "lanes": width,
                    "us_per_useful_step": f"{1e6 * seconds / n_steps:.2f}",
                    "lane_efficiency": f"{result.attrs['lane_efficiency']:.3f}",
                    "runs_per_second_and_core": f"{N_RUNS / 2 / seconds:.0f}",
                }
            )
    write("sweep_steps", "python benchmarks/sweeps.py steps", rows)


# Widths ------------------------------------------------------------------------------------------------------------


def widths() -> None:
    """Milliseconds of a core for a run in 24 and in 64 lanes, of other joints and with sensitivities."""
    clearances = {"clearance": CLEARANCES[::2]}
    height = "final position.rocker"
    by = sj.studies.Sensitivity(KEPT, by=PARAMETERS), sj.studies.Sensitivity(KEPT, by=PARAMETERS[:1])
    cases = {
        "dry": (dry, clearances, DURATION, [height], 1e-8),
        "bushing": (elastic, {"stiffness": np.geomspace(3e5, 3e6, N_RUNS // 2)}, DURATION, [height], 1e-8),
        "film": (film, clearances, DURATION, [height], 1e-6),
        "dry, sensitivities by one": (dry_of_three, runs_of(), 0.05, [KEPT, by[1]], 1e-7),
        "dry, sensitivities by three": (dry_of_three, runs_of(), 0.05, [KEPT, by[0]], 1e-7),
    }
    rows = []
    for name, (build, runs, duration, record, rtol) in cases.items():
        chunk = 100 if "sensitivities" in name else 250
        for width in (24, 64):
            result = sj.sweep(
                build, runs, [0.0, duration], record=record, rtol=rtol, block=sj.solvers.Block(width), workers=1,
                chunk=chunk, progress=False,
            )  # fmt: skip
            taken = 1e3 / chunk * float(np.median(result.attrs["seconds_of_chunks"]))
            rows.append({"case": name, "lanes": width, "runs_at_a_time": chunk, "ms_per_run": f"{taken:.2f}"})
    write("sweep_widths", "python benchmarks/sweeps.py widths", rows)


PARTS = {
    "throughput": throughput,
    "steps": steps,
    "widths": widths,
    "jobs": jobs,
    "killed": killed,
    "exudyn": exudyn,
    "sensitivities": sensitivities,
    "gpu": gpu,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
