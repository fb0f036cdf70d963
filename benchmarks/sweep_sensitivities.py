"""What derivatives of every run cost: recorded sensitivities against differences; a part of `sweeps.py`.

Dry four-bars with friction through their first impacts; kept are the rocker's final position and its derivatives by
one, two and three parameters. Both ways run at the loosest tolerance with which the median error of the runs'
derivatives is below `ACCURACY`, relative to the largest derivative of the run; central differences with the shift that
suits them best. A sweep is as good as its derivatives where contacts graze too, so a third row says what differences
cost whose error in the run that is worse than 95 of 100 is no larger than that of the recorded sensitivities; where no
tolerance brings them there, the row is of the least such error. The reference are sensitivities at a far tighter
tolerance.
"""

from collections.abc import Callable
from itertools import product

import diffrax
import numpy as np
from machine import write
from sweep_scenes import N_CORES

import spherejax as sj

N_RUNS, DURATION = 200, 0.05
ACCURACY, REFERENCE = 1e-6, 1e-11
TOLERANCES = (1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 3e-9, 1e-9, 3e-10, 1e-10)
SHIFTS = (1e-3, 1e-4, 1e-5)
REPEATS = 5
KEPT, NAME = "final position.rocker", "final_position.rocker"
PARAMETERS = ("clearance", "mu", "restitution")


def dry(clearance, mu, restitution):
    """The four-bar with dry friction."""
    normal = sj.LankaraniNikravesh(restitution=restitution)
    return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu)))


def runs_of(shift: float = 0.0, shifted: str = "") -> sj.studies.Grid:
    """The runs, with one parameter shifted by a fraction of itself."""
    values = {
        "clearance": np.linspace(0.8e-4, 1.2e-4, N_RUNS),
        "mu": np.tile(np.linspace(0.05, 0.15, 20), N_RUNS // 20),
        "restitution": np.tile(np.linspace(0.5, 0.9, 25), N_RUNS // 25),
    }
    if shifted:
        values[shifted] = values[shifted] * (1 + shift)
    return sj.studies.zipped(values)


def swept(grid: sj.studies.Grid, rtol: float, by: tuple[str, ...] = ()):
    """One sweep; derivatives by some parameters besides."""
    record = [KEPT, *([sj.studies.Sensitivity(KEPT, by=by)] if by else [])]
    return sj.sweep(
        dry, grid, [0.0, DURATION], record=record, rtol=rtol, solver=diffrax.Dopri8(), chunk=N_RUNS // N_CORES,
        progress=False,
    )  # fmt: skip


def slopes(by: tuple[str, ...], rtol: float) -> np.ndarray:
    """Recorded derivatives times the parameters, shape (n_runs, 3, p)."""
    values = runs_of().values
    found = swept(runs_of(), rtol, by)[f"sensitivity_{NAME}"].transpose("run", "axis", "parameter").values
    return found * np.stack([values[name] for name in by], -1)[:, None, :]


def differences(by: tuple[str, ...], rtol: float, shift: float) -> np.ndarray:
    """Relative central differences, shape (n_runs, 3, p)."""
    ends = [[swept(runs_of(sign * shift, name), rtol)[NAME].values for sign in (1, -1)] for name in by]
    return np.stack([(ahead - behind) / (2 * shift) for ahead, behind in ends], axis=-1)


def accurate(found: Callable, choices, exact: np.ndarray, percent: float, limit: float) -> tuple[tuple, np.ndarray]:
    """The first choice that makes the errors of so many runs small enough, or the least; and the errors of all runs."""
    size = np.abs(exact).max(axis=(1, 2), keepdims=True)
    best = None
    for choice in choices:
        errors = np.abs((found(*choice) - exact) / size).max(axis=(1, 2))
        reached = np.percentile(errors, percent)
        print(f"{found.__name__} at {choice}: error of {percent} % {reached:.1e}", flush=True)
        if best is None or reached < best[0]:
            best = reached, choice, errors
        if reached <= limit:
            break
    return best[1:]


def us_per_run(rtol: float, by: tuple[str, ...] = ()) -> float:
    """Time of a core for a run [us]; a first sweep compiles."""
    swept(runs_of(), rtol, by)
    taken = [np.sum(swept(runs_of(), rtol, by).attrs["seconds_of_chunks"]) for _ in range(REPEATS)]
    return 1e6 * float(np.median(taken)) / N_RUNS


def sensitivities() -> None:
    """Cost of derivatives at the same achieved error, by the number of parameters."""
    rows = []
    for p in range(1, len(PARAMETERS) + 1):
        by = PARAMETERS[:p]
        exact = slopes(by, REFERENCE)

        def recorded_at(rtol, by=by):
            return slopes(by, rtol)

        def differences_at(rtol, shift, by=by):
            return differences(by, rtol, shift)

        recorded, own = accurate(recorded_at, product(TOLERANCES), exact, 50, ACCURACY)
        ways = product(TOLERANCES, SHIFTS)
        differenced, others = accurate(differences_at, ways, exact, 50, ACCURACY)
        ways = product(TOLERANCES, SHIFTS)
        as_exact, those = accurate(differences_at, ways, exact, 95, np.percentile(own, 95))
        for way, (rtol, *shift), errors, taken in (
            ("recorded sensitivities", recorded, own, us_per_run(recorded[0], by)),
            ("central differences", differenced, others, 2 * p * us_per_run(differenced[0])),
            ("differences as exact in 95 %", as_exact, those, 2 * p * us_per_run(as_exact[0])),
        ):
            rows.append(
                {
                    "parameters": p,
                    "derivatives_by": way,
                    "rtol": f"{rtol:.0e}",
                    "shift": "".join(f"{each:.0e}" for each in shift),
                    "us_per_run_and_core": f"{taken:.0f}",
                    "median_error": f"{np.median(errors):.1e}",
                    "error_of_95_percent": f"{np.percentile(errors, 95):.1e}",
                    "worst_error": f"{errors.max():.1e}",
                }
            )
    write("sweep_sensitivities", "python benchmarks/sweeps.py sensitivities", rows)
