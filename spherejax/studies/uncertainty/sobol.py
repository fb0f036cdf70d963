"""`sj.studies.sobol_indices`: which number's scatter makes which share of the variance of what is observed.

Source: SciPy's `sobol_indices` (the estimators of Saltelli et al. (2010), Computer Physics Communications 181:259-270).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Array, Float

from spherejax.foundations.errors import SceneError
from spherejax.foundations.forms import whole_number
from spherejax.motion.runs.many import Build
from spherejax.studies.random_numbers import Rng, generator, rng_was_seed
from spherejax.studies.sweep.grids import zipped
from spherejax.studies.sweep.records import Wanted
from spherejax.studies.sweep.run import sweep
from spherejax.studies.sweep.spreads import Scattered, Spread
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

RESAMPLES = 200
"""Of the runs, for the errors of the indices: their standard deviations are then right to 5 %."""


@dataclass(frozen=True)
class Shares:
    """Indices of one output.

    Attributes:
        output: the output, of the runs that the variance is taken of.
        first: share of the variance that a number makes by itself, shape (entries, p).
        total: share that would be left if all others were known, shape (entries, p).
        first_error, total_error: standard deviations of these for the finite number of runs.
        deviation: standard deviation of each entry, shape (entries,).
    """

    output: Output
    first: Float[np.ndarray, "c p"]
    total: Float[np.ndarray, "c p"]
    first_error: Float[np.ndarray, "c p"]
    total_error: Float[np.ndarray, "c p"]
    deviation: Float[np.ndarray, " c"]


@dataclass(frozen=True)
class SobolIndices:
    """Shares of the variance of outputs by what scatters; prints as a table.

    Attributes:
        numbers: what scatters.
        shares: one for each output.
        runs: all runs, as `sj.sweep` gives them.
        n: base samples.
        note: which were left out; empty for none.
    """

    numbers: tuple[Scattered, ...] = field(repr=False)
    shares: tuple[Shares, ...] = field(repr=False)
    runs: "xarray.Dataset" = field(repr=False)
    n: int = 0
    note: str = ""

    @property
    def names(self) -> list[str]:
        """Of what scatters."""
        return [number.name for number in self.numbers]

    def of(self, output: str) -> Shares:
        """The indices of an output.

        Raises:
            KeyError: for one that was not kept.
        """
        found = next((each for each in self.shares if each.output.name == output), None)
        if found is None:
            known = ", ".join(repr(each.output.name) for each in self.shares)
            raise KeyError(f"{output!r} was not kept; there are {known}")
        return found

    def to_xarray(self) -> "xarray.Dataset":
        """`first.NAME`, `total.NAME` and their errors `.error`, with the output's own dimensions and `parameter`."""
        import xarray

        variables = {}
        for each in self.shares:
            own = each.output
            for kind in ("first", "total"):
                for end, values in (("", getattr(each, kind)), (".error", getattr(each, f"{kind}_error"))):
                    shape = (*own.values.shape[1:], len(self.numbers))
                    variables[f"{kind}.{own.name}{end}"] = ((*own.dims, "parameter"), values.reshape(shape))
        kept = {dim for each in self.shares for dim in each.output.dims}
        coordinates = {dim: self.runs[dim].values for dim in kept if dim in self.runs.coords}
        return xarray.Dataset(variables, {**coordinates, "parameter": self.names}, {"n": self.n, "note": self.note})

    def figures(self) -> "dict[str, Figure]":
        """For each output bars of first and total indices with their errors; along time, where it depends on it."""
        from spherejax.output.plot.uncertainty import shares_figure, shares_in_time_figure

        ts = np.asarray(self.runs["time"].values) if "time" in self.runs.coords else np.zeros(0)
        return {
            each.output.name: shares_in_time_figure(each, self.names, ts)
            if "time" in each.output.dims
            else shares_figure(each, self.names)
            for each in self.shares
        }

    def __str__(self) -> str:
        rows: list[tuple[str, ...]] = [("output", "number", "first", "+-", "total", "+-")]
        for each in self.shares:
            for c in most_scattered(each.output, each.deviation):
                for k in np.argsort(-each.total[c], kind="stable"):
                    numbers = (each.first[c, k], each.first_error[c, k], each.total[c, k], each.total_error[c, k])
                    rows.append((each.output.labels[c], self.names[k], *(f"{x:.3f}" for x in numbers)))
        heads = [f"Shares of the variance, {self.runs.sizes['run']} runs:", *table(rows)]
        return "\n".join([*heads, *([self.note] if self.note else [])])


@rng_was_seed
def sobol_indices(
    build: Build,
    spreads: Mapping[str, Spread],
    ts: Float[Array, " n"],
    *,
    record: Wanted,
    n: int = 256,
    rng: Rng = 0,
    **options: Any,
) -> SobolIndices:
    """Which share of the variance of an output each number makes, alone and together with others.

        S_k = Var(E[y | x_k]) / Var(y),   T_k = 1 - Var(E[y | all but x_k]) / Var(y)

    T_k - S_k is what x_k does together with others; the sum of S_k falls short of one by that. No derivative and no
    small scatter is assumed. It costs n (p + 2) runs for p numbers; an output that does not vary has indices of zero.

    Args:
        build: makes a `Scene` from the numbers, given by keyword. It is traced.
        spreads: by name a `sj.studies.Tolerance`, a range (least, largest) or a distribution of scipy.stats;
            independent.
        ts: sample times [s], increasing.

    Other args:
        record: what is kept of each run, as in `sj.sweep`.
        n: base samples, a power of two.
        rng: of the scrambled Sobol sequence and of the resampling, a whole number or a generator.
        options: of `sj.sweep`: rtol, atol, solver, max_steps, block, chunk, workers, executor, store, progress.

    Returns:
        Indices with standard errors (by resampling the runs), a table (`print`), `figures()`, and all runs.

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed; where fewer than two base
            samples are left.

    Warns:
        UncertaintyWarning: where runs failed: base samples with one of them are left out.
    """
    numbers = scattered_numbers(spreads)
    n = whole_number("n", n, "It counts the base samples.")
    if n < 2 or n & (n - 1):
        raise SceneError(f"sobol_indices: n = {n} must be a power of two, at least 2: Sobol's points fill the space so")
    A, B = _base(numbers, n, rng)
    p = len(numbers)
    # All of A, all of B, then A with one number after the other taken from B.
    mixed = [np.where(np.arange(p)[:, None] == k, B, A) for k in range(p)]
    rows = np.concatenate([A, B, *mixed], axis=1)
    grid = zipped({number.name: rows[k] for k, number in enumerate(numbers)})
    runs = along_time(sweep(build, grid, ts, record=record, **options))
    outputs = outputs_of(runs)
    good = usable(runs, outputs)
    base = np.flatnonzero(np.all(good.reshape(p + 2, n), axis=0))
    left = f"{len(base)} of {n} base samples have no failed run"
    note = tell_of_failures("sobol_indices", runs, good, left, is_enough=len(base) > 1, stacklevel=2)
    shares = tuple(_shares(output, p, n, base, rng) for output in outputs)
    return SobolIndices(tuple(numbers), shares, runs, n, note)


def _base(numbers: list[Scattered], n: int, rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """Two independent samples of all numbers, each of shape (p, n)."""
    from scipy.stats import qmc

    p = len(numbers)
    points = qmc.Sobol(2 * p, rng=generator(rng)).random(n).T
    A = np.stack([number.at(points[k]) for k, number in enumerate(numbers)])
    return A, np.stack([number.at(points[p + k]) for k, number in enumerate(numbers)])


def _shares(output: Output, p: int, n: int, base: np.ndarray, rng: Rng) -> Shares:
    """Indices of an output from the base samples that can be used."""
    values = np.moveaxis(output.flat.reshape(p + 2, n, -1), -1, 1)  # (p + 2, entries, n)
    draws = generator(rng)
    # SciPy asks for a power of two: where samples are left out, others count twice.
    whole = base if len(base) == n else np.concatenate([base, draws.choice(base, n - len(base))])
    first, total = _indices(values[..., whole])
    resampled = np.stack([_indices(values[..., draws.choice(base, n)]) for _ in range(RESAMPLES)])
    first_error, total_error = resampled.std(0, ddof=1)
    deviation = values[:2][..., base].transpose(1, 0, 2).reshape(len(first), -1).std(1)
    return Shares(output, first, total, first_error, total_error, deviation)


def _indices(values: Float[np.ndarray, "p2 c n"]) -> Float[np.ndarray, "2 c p"]:
    from scipy import stats

    # SciPy divides by the variance; in units of the deviation that neither underflows nor overflows.
    deviation = values[:2].std(axis=(0, 2), keepdims=True)
    scaled = values / np.where(deviation > 0, deviation, 1.0)
    n, shape = values.shape[-1], (values.shape[1], len(values) - 2)
    found = stats.sobol_indices(func={"f_A": scaled[0], "f_B": scaled[1], "f_AB": scaled[2:]}, n=n)
    varies = (deviation > 1e-12 * np.abs(values[:2]).max(axis=(0, 2), keepdims=True))[0]
    return np.stack([np.where(varies, np.reshape(each, shape), 0.0) for each in (found.first_order, found.total_order)])
