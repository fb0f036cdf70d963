"""`sj.monte_carlo`: runs whose numbers are drawn as they scatter, and the scatter of what is observed."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Bool, Float

from spherejax.foundations.forms import whole_number
from spherejax.motion.runs.many import Build
from spherejax.studies.random_numbers import Rng, rng_was_seed
from spherejax.studies.sweep.grids import random_samples
from spherejax.studies.sweep.records import Wanted
from spherejax.studies.sweep.run import sweep
from spherejax.studies.sweep.spreads import Spread
from spherejax.studies.uncertainty.outputs import (
    Output,
    along_time,
    most_scattered,
    outputs_of,
    scattered_numbers,
    table,
    tell_of_failures,
    usable,
)

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Scatter:
    """Runs whose numbers were drawn; prints mean, standard deviation and quantiles.

    Attributes:
        runs: all of them, as `sj.sweep` gives them.
        outputs: what was kept of each.
        is_used: which of them succeeded, shape (n,).
        note: which were left out; empty for none.
    """

    runs: "xarray.Dataset" = field(repr=False)
    outputs: tuple[Output, ...] = field(repr=False)
    is_used: Bool[np.ndarray, " n"] = field(repr=False)
    note: str = ""

    @cached_property
    def used(self) -> "xarray.Dataset":
        """What was kept of the runs that succeeded."""
        return self.runs[[output.name for output in self.outputs]].isel(run=np.flatnonzero(self.is_used))

    @property
    def mean(self) -> "xarray.Dataset":
        """Of each output."""
        return self.used.mean("run", keep_attrs=True)

    @property
    def deviation(self) -> "xarray.Dataset":
        """Standard deviation of each output."""
        return self.used.std("run", ddof=1, keep_attrs=True)

    @property
    def error_of_mean(self) -> "xarray.Dataset":
        """Standard deviation of the mean for the finite number of runs."""
        return self.deviation / np.sqrt(self.is_used.sum())

    def quantile(self, share: Any) -> "xarray.Dataset":
        """The values below which a share of the runs lies, or several shares."""
        return self.used.quantile(share, "run", keep_attrs=True)

    def __str__(self) -> str:
        n = int(self.is_used.sum())
        rows: list[tuple[str, ...]] = [("output", "mean", "+-", "deviation", "2.5 %", "50 %", "97.5 %", "unit")]
        for output in self.outputs:
            flat = output.flat[self.is_used]
            deviations = flat.std(0, ddof=1)
            for c in most_scattered(output, deviations):
                numbers = (
                    flat[:, c].mean(),
                    deviations[c] / np.sqrt(n),
                    deviations[c],
                    *np.quantile(flat[:, c], [0.025, 0.5, 0.975]),
                )
                rows.append((output.labels[c], *(f"{x:.4g}" for x in numbers), output.unit))
        lines = [f"Scatter of {n} runs:", *(line.rstrip() for line in table(rows))]
        return "\n".join([*lines, *([self.note] if self.note else [])])

    def figures(self) -> "dict[str, Figure]":
        """For each output how often its values occur; of one that depends on time bands with shares of the runs."""
        from spherejax.output.plot.swept import figures_of_sweep
        from spherejax.output.plot.uncertainty import histograms_figure

        in_time = [output.name for output in self.outputs if "time" in output.dims]
        rest = [output for output in self.outputs if "time" not in output.dims]
        dropped = [output.name for output in rest]
        fans = figures_of_sweep(self.runs.drop_vars(dropped), "Runs drawn at random") if in_time else {}
        counts = {each.name: histograms_figure(each._replace(values=each.values[self.is_used])) for each in rest}
        return {name: figure for name, figure in {**fans, **counts}.items() if name in (*in_time, *dropped)}


@rng_was_seed
def monte_carlo(
    build: Build,
    spreads: Mapping[str, Spread],
    ts: Float[Array, " n"],
    *,
    record: Wanted,
    n: int = 1000,
    rng: Rng = 0,
    **options: Any,
) -> Scatter:
    """Runs whose numbers are drawn as they scatter, independently of each other.

    Args:
        build: makes a `Scene` from the numbers, given by keyword. It is traced.
        spreads: by name a `sj.studies.Tolerance`, a range (least, largest) or a distribution of scipy.stats.
        ts: sample times [s], increasing.

    Other args:
        record: what is kept of each run, as in `sj.sweep`.
        n: number of runs, at least two.
        rng: of the random numbers, a whole number or a generator; None: others each time.
        options: of `sj.sweep`: rtol, atol, solver, max_steps, block, chunk, workers, executor, store, progress.

    Returns:
        Mean, deviation, quantiles, a table (`print`), `figures()`, and all runs.

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed; where fewer than two runs
            succeed.

    Warns:
        UncertaintyWarning: where runs failed and are left out.
    """
    scattered_numbers(spreads)
    n = whole_number("n", n, "It counts the runs.", least=2)
    runs = along_time(sweep(build, random_samples(spreads, n, rng=rng), ts, record=record, **options))
    outputs = outputs_of(runs)
    good = usable(runs, outputs)
    left = f"{int(good.sum())} of {n} runs are left"
    note = tell_of_failures("monte_carlo", runs, good, left, is_enough=good.sum() > 1, stacklevel=2)
    return Scatter(runs, tuple(outputs), good, note)
