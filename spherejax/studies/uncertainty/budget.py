"""`sj.studies.tolerance_budget`: what tolerances make of a motion to first order, from derivatives at their middle."""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import diffrax
import numpy as np
from jaxtyping import Array, Float

from spherejax.motion.results.trajectory import Trajectory
from spherejax.motion.runs.many import Build
from spherejax.studies.sensitivity.sensitivity_result import Sensitivities, SlopesColumn
from spherejax.studies.sensitivity.study import Wanted, sensitivity
from spherejax.studies.sweep.grids import zipped
from spherejax.studies.sweep.run import sweep
from spherejax.studies.sweep.spreads import Scattered, Spread
from spherejax.studies.uncertainty.outputs import (
    UncertaintyWarning,
    outputs_of,
    scattered_numbers,
    table,
    usable,
)

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

STRAIGHT = 0.2
"""Largest share of the standard deviation by which the first order may be off without a word."""

ROUNDING = 1e-4
"""Percent of the deviation below which nobody wants to know the number."""

NOTHING = 1e-10
"""Change of what is observed, as a share of its size, that is rounding."""

LEAST_SHARE = 5e-4
"""Shares of the variance below this are printed as zero."""


@dataclass(frozen=True)
class BudgetPart:
    """The budget of one observable.

    Attributes:
        column: its values and derivatives along time.
        effects: what a standard deviation of each number changes, shape (n, components, p).
        deviation: standard deviation, the root of the sum of their squares, shape (n, components).
        worst: what all numbers at their limits can change together, shape (n, components).
        bent: by how much runs at one deviation to either side depart from the derivatives, as a share of the largest
            deviation; NaN where one of them failed, None where it was not checked.
    """

    column: SlopesColumn
    effects: Float[np.ndarray, "n c p"]
    deviation: Float[np.ndarray, "n c"]
    worst: Float[np.ndarray, "n c"]
    bent: float | None

    @property
    def shares(self) -> Float[np.ndarray, "n c p"]:
        """Share of the variance that each number makes; zero where there is none."""
        variance = self.deviation[..., None] ** 2
        return np.divide(self.effects**2, variance, out=np.zeros_like(self.effects), where=variance > 0)


@dataclass(frozen=True)
class ToleranceBudget:
    """What tolerances make of what is observed, to first order; prints as a table.

    Attributes:
        numbers: what scatters.
        parts: one for each observable.
        sensitivities: the derivatives that it rests on.
        note: what the check of the first order found.
    """

    numbers: tuple[Scattered, ...] = field(repr=False)
    parts: tuple[BudgetPart, ...] = field(repr=False)
    sensitivities: Sensitivities = field(repr=False)
    note: str = ""

    @property
    def names(self) -> list[str]:
        """Of what scatters."""
        return [number.name for number in self.numbers]

    def of(self, observable: str) -> BudgetPart:
        """The budget of an observable.

        Raises:
            KeyError: for one that was not asked for.
        """
        column = self.sensitivities.column(observable)
        return next(part for part in self.parts if part.column is column)

    def to_xarray(self) -> "xarray.Dataset":
        """Values and derivatives as of `sj.sensitivity`, with `deviation.NAME`, `worst.NAME` and `share.NAME`."""
        found = self.sensitivities.to_xarray()
        for part in self.parts:
            name = part.column.name
            slopes = found[f"sensitivity.{name}"]
            own = found[name]
            attributes = {"units": part.column.unit} if part.column.unit else {}
            found[f"deviation.{name}"] = own.copy(data=part.deviation.reshape(own.shape)).assign_attrs(
                attributes, long_name=f"standard deviation of {name}, first order"
            )
            found[f"worst.{name}"] = own.copy(data=part.worst.reshape(own.shape)).assign_attrs(
                attributes, long_name=f"largest change of {name} within all tolerances, first order"
            )
            found[f"share.{name}"] = slopes.copy(data=part.shares.reshape(slopes.shape)).assign_attrs(
                units="1", long_name=f"share of the variance of {name}"
            )
        found["deviation"] = ("parameter", [number.deviation for number in self.numbers])
        found["half_width"] = ("parameter", [number.half_width for number in self.numbers])
        return found.assign_attrs(note=self.note)

    def figures(self) -> "dict[str, Figure]":
        """A figure for each observable, what each number contributes along time, and one of all shares (`"shares"`)."""
        from spherejax.output.plot.uncertainty import budget_figure, stacks_figure

        figures = {}
        if len(self.sensitivities.ts) > 1:
            figures = {part.column.name: budget_figure(part, self.names, self.sensitivities.ts) for part in self.parts}
        figures["shares"] = stacks_figure([(label, shares) for label, *_, shares in self._largest()], self.names)
        return figures

    def _largest(self) -> list[tuple[str, float, float, float, np.ndarray]]:
        """Of each component that scatters: label, deviation, worst change, time, shares, where it scatters most."""
        found = []
        for part in self.parts:
            reached = np.where(np.isfinite(part.deviation), part.deviation, -1.0)
            for c, label in enumerate(part.column.labels):
                i = int(np.argmax(reached[:, c]))
                if reached[i, c] > 1e-9 * reached.max():
                    t = float(self.sensitivities.ts[i])
                    found.append((label, part.deviation[i, c], part.worst[i, c], t, part.shares[i, c]))
        return found

    def __str__(self) -> str:
        return self.told({})

    def told(self, units: Mapping[str, tuple[str, float]]) -> str:
        """As a text, with numbers in units.

        Args:
            units: by number its unit, and what numbers in it are multiplied by to be in SI units; where nothing is said
                it is in SI units, and none is named.
        """
        heads = [("number", "middle", "+-", "deviation", "unit")]
        for each in self.numbers:
            unit, factor = units.get(each.name, ("", 1.0))
            middle, half_width, spread = (x / factor for x in (each.nominal, each.half_width, each.deviation))
            heads.append((each.name, f"{middle:.6g}", f"{half_width:.3g}", f"{spread:.3g}", unit))
        if not any(unit for *_, unit in heads[1:]):
            heads = [row[:-1] for row in heads]
        rows = [("observable", "deviation", "worst", "unit", "at", *self.names)]
        unit_of = {label: part.column.unit for part in self.parts for label in part.column.labels}
        for label, deviation, worst, t, shares in self._largest():
            said = [f"{100 * share:.1f} %" if share >= LEAST_SHARE else "-" for share in shares]
            rows.append((label, f"{deviation:.3g}", f"{worst:.3g}", unit_of[label], f"{t:.4g} s", *said))
        lines = ["Tolerance budget, first order:", *table(heads), "", "Where each scatters most, and which number's:"]
        lines += [*table(rows), *([self.note] if self.note else [])]
        return "\n".join(line.rstrip() for line in lines)


def tolerance_budget(
    build: Build,
    spreads: Mapping[str, Spread],
    ts: Float[Array, " n"],
    *,
    observables: Wanted | None = None,
    of: Callable[[Trajectory], Any] | None = None,
    check: bool = True,
    rtol: float = 1e-8,
    atol: float | None = None,
    solver: diffrax.AbstractSolver | None = None,
    max_steps: int = 20_000_000,
) -> ToleranceBudget:
    """What tolerances make of what is observed, to first order, and which of them makes most of it.

        sigma_y^2 = sum_k (dy/dx_k sigma_k)^2,   worst = sum_k |dy/dx_k| t_k

    It costs one run with derivatives; and that the motion is straight enough for it is checked by two more runs for
    each number, at one deviation to either side. Where impacts make it bend, `sj.studies.sobol_indices` and
    `sj.monte_carlo` assume nothing.

    Args:
        build: makes a `Scene` from the numbers, given by keyword. It is traced.
        spreads: by name a `sj.studies.Tolerance`, a range (least, largest) or a distribution of scipy.stats;
            independent. The derivatives are taken at the means.
        ts: sample times [s], increasing.

    Other args:
        observables, of: as in `sj.sensitivity`: names, or functions of a run with a row for each sample; or a function
            from a run to one number.
        check: whether the first order is checked.
        rtol, atol, solver, max_steps: as in `simulate`.

    Returns:
        Standard deviations, worst cases and shares along time: `print`, `.of(name)`, `.to_xarray()`, `.figures()`.

    Raises:
        SceneError: for a request that cannot be answered, before anything is computed.

    Warns:
        UncertaintyWarning: where the first order is off by more than a fifth of the deviation, a run of the check
            fails, or the run at the middle stops early.
    """
    numbers = scattered_numbers(spreads)
    middle = {number.name: number.nominal for number in numbers}
    how = {"rtol": rtol, "atol": atol, "solver": solver, "max_steps": max_steps}
    found = sensitivity(build, middle, ts, observables=observables, of=of, **how)
    deviations = np.array([number.deviation for number in numbers])
    widths = np.array([number.half_width for number in numbers])
    steps = np.array([number.step for number in numbers])
    aside = _aside(build, numbers, steps, ts, observables, of, how) if check else None
    parts = []
    for column in found.columns:
        effects = column.slopes * deviations
        deviation = np.sqrt(np.sum(effects**2, axis=-1))
        worst = np.sum(np.abs(column.slopes) * widths, axis=-1)
        bent = None if aside is None else _bent(column.values, effects, aside[column.name], steps / deviations)
        parts.append(BudgetPart(column, effects, deviation, worst, bent))
    note = _judged(parts, found.diagnosis)
    return ToleranceBudget(tuple(numbers), tuple(parts), found, note)


def _aside(build, numbers: list[Scattered], steps, ts, observables, of, how) -> dict[str, np.ndarray]:
    """What is observed a step to either side of each number, the others at their middle.

    Returns:
        By name of the observable shape (2 p, n, components), upwards first; NaN of a run that failed.
    """
    p = len(numbers)
    rows = np.array([number.nominal for number in numbers])[:, None] + np.concatenate(
        [sign * np.diag(steps) for sign in (1, -1)], axis=1
    )
    grid = zipped({number.name: rows[k] for k, number in enumerate(numbers)})
    record = {getattr(of, "__name__", "function"): of} if of is not None else observables
    runs = sweep(build, grid, ts, record=record, progress=False, **how)
    outputs = outputs_of(runs)
    good = usable(runs, outputs)
    n = 1 if of is not None else len(ts)
    return {
        output.name: np.where(good[:, None, None], output.values.reshape(2 * p, n, -1), np.nan) for output in outputs
    }


def _bent(values, effects, aside, lengths) -> float:
    """The part that derivatives miss, as a share of the largest deviation; NaN where a run failed.

    Args:
        values, effects, aside: of the middle, by derivatives, to either side.
        lengths: of the steps aside, in deviations.
    """
    reached = np.all(np.isfinite(values), axis=1) & np.all(np.isfinite(effects), axis=(1, 2))
    up, down = np.split(np.moveaxis(aside - values, 0, -1), 2, axis=-1)  # (n, c, p)
    even, odd = (up + down) / 2 / lengths, (up - down) / 2 / lengths - effects
    missed = np.sqrt(np.sum(np.maximum(np.abs(even), np.abs(odd)) ** 2, axis=(1, 2)))[reached]
    deviation = np.sqrt(np.sum(effects**2, axis=(1, 2)))[reached]
    # Where derivatives vanish and the motion bends all the same (a best point), the first order misses everything.
    # The least is a normal number also behind the product: threads of XLA flush smaller ones to zero.
    rounding = NOTHING * np.abs(values[reached]).max(initial=1e-200)
    return float(missed.max(initial=0.0) / max(deviation.max(initial=0.0), rounding))


def _judged(parts: list[BudgetPart], diagnosis: str) -> str:
    """What the check says, and a warning where it is bad, or where the run at the middle stopped early."""
    made = {part.column.name: part.bent for part in parts if part.bent is not None}
    failed = [name for name, share in made.items() if not np.isfinite(share)]
    off = {name: share for name, share in made.items() if share > STRAIGHT}
    if diagnosis:
        text = f"tolerance_budget: the run with all numbers at their middle stopped early: {diagnosis}"
    elif not made:
        return "That the first order suffices was not checked (check=False)."
    elif failed:
        text = (
            f"tolerance_budget: runs at one deviation aside failed, so that nothing says whether the first order of "
            f"{', '.join(failed)} suffices; sj.monte_carlo tells which numbers fail"
        )
    elif off:
        said = ", ".join(f"{name} by {f'{100 * s:.0f} %' if s < 10 else 'many times'}" for name, s in off.items())
        text = (
            f"tolerance_budget: at one deviation aside the first order is off, as a share of the largest deviation: "
            f"{said}. Take sj.studies.sobol_indices or sj.monte_carlo, which assume no straight lines, or "
            f"smaller tolerances"
        )
    else:
        worst = 100 * max(made.values())
        said = f"to {worst:.2g} %" if worst > ROUNDING else f"to better than {ROUNDING:g} %"
        return f"Checked at one deviation to either side: the first order holds {said} of the deviation."
    warnings.warn(text, UncertaintyWarning, stacklevel=3)
    return text
