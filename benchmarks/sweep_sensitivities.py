"""What derivatives of every run cost: recorded sensitivities against plain runs and differences; a part of `sweeps.py`.

Dry four-bars with friction through their first impacts; kept are the rocker's final position and its derivatives by
one, two and three parameters. Differences are central, with the shift that suits them best. Errors of derivatives are
relative to the largest of the run, against sensitivities at `REFERENCE`.
"""

import diffrax
import numpy as np
from machine import write
from sweep_scenes import N_CORES

import spherejax as sj

N_RUNS, DURATION, RTOL, REFERENCE = 1_000, 0.05, 1e-8, 1e-12
REPEATS = 3
SHIFTS = (1e-3, 1e-4, 1e-5, 1e-6)
RECORD = "final position.rocker"


def dry(clearance, mu, restitution):
    """The four-bar with dry friction."""
    normal = sj.LankaraniNikravesh(restitution=restitution)
    return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu)))


def runs_of(shift: float = 0.0, shifted: str = "") -> sj.Grid:
    """The runs, with one parameter shifted by a fraction of itself."""
    values = {
        "clearance": np.linspace(0.8e-4, 1.2e-4, N_RUNS),
        "mu": np.tile(np.linspace(0.05, 0.15, 20), N_RUNS // 20),
        "restitution": np.tile(np.linspace(0.5, 0.9, 25), N_RUNS // 25),
    }
    if shifted:
        values[shifted] = values[shifted] * (1 + shift)
    return sj.zipped(values)


def swept(grid: sj.Grid, by: tuple[str, ...] = (), rtol: float = RTOL):
    """One sweep; derivatives by some parameters besides."""
    record = [RECORD, *([sj.Sensitivity(RECORD, by=by)] if by else [])]
    return sj.sweep(
        dry, grid, [0.0, DURATION], record=record, rtol=rtol, solver=diffrax.Dopri8(), chunk=N_RUNS // N_CORES,
        progress=False,
    )  # fmt: skip


def seconds(by: tuple[str, ...] = ()) -> float:
    """Of the chunks of a sweep, the core's time for all runs; a first sweep compiles."""
    swept(runs_of(), by)
    return float(np.median([np.sum(swept(runs_of(), by).attrs["seconds_of_chunks"]) for _ in range(REPEATS)]))


def differences(by: tuple[str, ...], shift: float) -> np.ndarray:
    """Relative central differences of all runs, shape (n_runs, 3, p)."""
    ends = [
        [swept(runs_of(sign * shift, name))["final_position.rocker"].values for sign in (1, -1)] for name in by
    ]  # fmt: skip
    return np.stack([(ahead - behind) / (2 * shift) for ahead, behind in ends], axis=-1)


def slopes(by: tuple[str, ...], rtol: float = RTOL) -> np.ndarray:
    """Recorded derivatives times the parameters, shape (n_runs, 3, p)."""
    values = runs_of().values
    found = swept(runs_of(), by, rtol)["sensitivity_final_position.rocker"]
    return found.transpose("run", "axis", "parameter").values * np.stack([values[name] for name in by], -1)[:, None, :]


def sensitivities() -> None:
    """Cost and error by the number of parameters."""
    names = ("clearance", "mu", "restitution")
    plain, rows = seconds(), []
    for p in range(1, len(names) + 1):
        by = names[:p]
        exact = slopes(by, REFERENCE)
        size = np.abs(exact).max(axis=(1, 2), keepdims=True)

        def errors(found, exact=exact, size=size) -> tuple[float, float]:
            each = np.abs((found - exact) / size).max(axis=(1, 2))
            return float(np.median(each)), float(each.max())

        by_shift = {shift: errors(differences(by, shift)) for shift in SHIFTS}
        best = min(by_shift, key=lambda shift: by_shift[shift][0])
        taken, own = seconds(by), errors(slopes(by))
        rows.append(
            {
                "derivatives_by": p,
                "us_per_plain_run_and_core": f"{1e6 * plain / N_RUNS:.0f}",
                "us_with_derivatives": f"{1e6 * taken / N_RUNS:.0f}",
                "cost_in_plain_runs": f"{taken / plain:.2f}",
                "error_median": f"{own[0]:.1e}",
                "error_worst": f"{own[1]:.1e}",
                "differences_cost_in_plain_runs": 2 * p,
                "differences_shift": f"{best:.0e}",
                "differences_error_median": f"{by_shift[best][0]:.1e}",
                "differences_error_worst": f"{by_shift[best][1]:.1e}",
            }
        )
    write("sweep_sensitivities", "python benchmarks/sweeps.py sensitivities", rows)
