"""`spherejax sweep --check N`: some runs of a sweep once more at a tenth of the tolerance, and what that changes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

import spherejax as sj
from spherejax.command_line.printing import print_table

if TYPE_CHECKING:
    import xarray

TIGHTER = 0.1
"""Of the tolerance of the sweep. A method of order p takes 10^(1/p) times the steps: 1.3 of order 8, 1.6 of order 5."""

UNRESOLVED = 0.01
"""Change, of the largest value that was kept, from which on a run counts as unresolved: what can be seen in a map."""


class Change(NamedTuple):
    """How much a quantity changes at a tighter tolerance.

    Attributes:
        name: of the quantity.
        unit: of the values.
        largest: change, in the unit.
        share: the same, of the largest value in all runs.
        run: the number of the run in which it is largest.
        values: there, at both tolerances; of a history at the instant at which the change is largest.
    """

    name: str
    unit: str
    largest: float
    share: float
    run: int
    values: tuple[float, float]


def check_runs(n: int, n_runs: int) -> list[int]:
    """Numbers of `n` runs that stand for all, evenly spread from the first to the last."""
    return sorted({round(k * (n_runs - 1) / max(n - 1, 1)) for k in range(min(n, n_runs))})


def changes(swept: xarray.Dataset, again: xarray.Dataset, runs: Sequence[int], names: Sequence[str]) -> list[Change]:
    """How quantities of some runs of a sweep change in a second one; runs that failed in one of both are left out.

    Args:
        swept: the sweep.
        again: the same runs at another tolerance.
        runs: their numbers in the sweep.
        names: of the quantities.
    """
    n_runs, largest_changes = swept["status"].size, []
    both = (np.asarray(swept["status"]).ravel()[list(runs)] == 0) & (np.asarray(again["status"]).ravel() == 0)
    for name in names:
        before = np.asarray(swept[name], float).reshape(n_runs, -1)
        first, second = before[list(runs)][both], np.asarray(again[name], float).reshape(len(runs), -1)[both]
        differences = np.abs(second - first)
        if not np.isfinite(differences).any():
            continue
        at, entry = np.unravel_index(np.nanargmax(differences), differences.shape)
        largest, size = float(differences[at, entry]), float(np.nanmax(np.abs(before)))
        run = int(np.asarray(runs)[both][at])
        values = (float(first[at, entry]), float(second[at, entry]))
        share = largest / size if size > 0 else 0.0
        largest_changes.append(Change(name, swept[name].attrs.get("units", ""), largest, share, run, values))
    return largest_changes


def print_check(
    swept: xarray.Dataset,
    names: Sequence[str],
    n: int,
    grid: sj.studies.Grid,
    rtol: float,
    sweep_again: Callable[[sj.studies.Grid, float], xarray.Dataset],
) -> None:
    """Make `n` runs once more at a tenth of the tolerance, and print what that changes.

    Args:
        swept: the sweep, in SI units.
        names: of the quantities.
        n: how many runs.
        grid: parameters of all runs.
        rtol: relative tolerance of the sweep.
        sweep_again: makes runs at a tolerance.
    """
    runs = check_runs(n, grid.n_runs)
    rows: list[Mapping[str, float]] = [grid.row(run) for run in runs]
    again = sweep_again(sj.studies.zipped({name: [row[name] for row in rows] for name in grid.names}), TIGHTER * rtol)
    of_values = changes(swept, again, runs, names)
    steps = np.asarray(swept["n_steps"]).ravel()[runs].sum(), np.asarray(again["n_steps"]).sum()
    print_table(
        f"{len(runs)} runs at the tolerances {rtol:g} and {TIGHTER * rtol:g}: {steps[0]:,} and {steps[1]:,} steps",
        ("quantity", "largest change", "of the largest value [%]", "run", f"at {rtol:g}", f"at {TIGHTER * rtol:g}"),
        [
            (
                f"{one.name} [{one.unit}]",
                f"{one.largest:.3g}",
                f"{100 * one.share:.2g}",
                f"{one.run}",
                *(f"{value:.6g}" for value in one.values),
            )
            for one in of_values
        ],
        numeric=True,
    )
    unresolved = [one for one in of_values if one.share > UNRESOLVED]
    if unresolved:
        print(
            f"unresolved at this tolerance: {', '.join(one.name for one in unresolved)}. Take a tighter --rtol; where "
            "the change stays as large the motion is chaotic, and only statistics of many runs mean something."
        )
