"""The result of an analysis of sensitivities: derivatives along time, which parameter matters when, and pictures."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float

from spherejax.motion.results.dataset import AXES, COMPONENTS

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure

_OWN_DIMS: dict[int, tuple[str, tuple[str, ...]]] = {3: ("axis", AXES), 4: ("component", COMPONENTS)}

_SHOWN = 12
"""Lines of the ranking that are printed."""


class Influence(NamedTuple):
    """How much a parameter matters to an observable.

    Attributes:
        parameter: its name.
        observable: the name of the observable.
        effect: root mean square along time of what the observable changes by for 1 % of the parameter, in its unit;
            for a parameter that is 0, for a change by 0.01 of its own unit.
        share: the same as a share of the observable's own variation along time (its norm about the mean; its size
            where it does not vary).
        t_largest: when the effect is largest [s].
    """

    parameter: str
    observable: str
    effect: float
    share: float
    t_largest: float


@dataclass(frozen=True)
class SlopesColumn:
    """One observable, and its derivatives by all parameters.

    Attributes:
        name: as it was asked for.
        unit: its unit; empty where it is not known.
        labels: names of its components.
        values: shape (n, components).
        slopes: derivatives, shape (n, components, p).
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    values: Float[np.ndarray, "n c"]
    slopes: Float[np.ndarray, "n c p"]


@dataclass(frozen=True)
class Sensitivities:
    """Derivatives of observables by parameters.

    Attributes:
        ts: sample times [s]; of a number that is made of the whole run (`of=`) its end alone.
        parameters: values by name; an entry of an array is called `"name[0]"`.
        columns: the observables.
        mode: "forward" or "reverse".
        reason: why this mode, and how the errors of the derivatives are controlled.
        method: which integrator is used, and why.
        diagnosis: why the run stopped early; empty where it reached its end.
        n_steps: steps of the run.
        seconds: time with compilation [s].
    """

    ts: Float[np.ndarray, " n"]
    parameters: Mapping[str, float]
    columns: tuple[SlopesColumn, ...]
    mode: str
    reason: str
    method: str
    diagnosis: str
    n_steps: int
    seconds: float

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self.parameters)

    @property
    def sizes(self) -> Float[np.ndarray, " p"]:
        """|p| of each parameter, or 1 where it is 0: what the normalised derivatives are multiplied by."""
        values = np.array(list(self.parameters.values()))
        return np.where(values == 0, 1.0, np.abs(values))

    def column(self, name: str) -> SlopesColumn:
        """An observable by name.

        Raises:
            KeyError: for one that was not asked for.
        """
        return next(column for column in self.columns if column.name == name) if name in self else _unknown(name, self)

    def __contains__(self, name: str) -> bool:
        """Whether an observable was asked for."""
        return any(column.name == name for column in self.columns)

    def derivative(self, observable: str, parameter: str) -> Float[np.ndarray, "n c"]:
        """dy/dp along time, in the units of the observable by those of the parameter."""
        return self.column(observable).slopes[:, :, self.names.index(parameter)]

    def normalized(self, observable: str) -> Float[np.ndarray, "n c p"]:
        """|p| dy/dp along time, in the units of the observable: 100 times what 1 % of the parameter changes."""
        return self.column(observable).slopes * self.sizes

    @property
    def ranking(self) -> list[Influence]:
        """Which parameter matters most: by share of the observable's variation, the largest first."""
        found = [self._influence(column, k) for column in self.columns for k in range(len(self.names))]
        return sorted(found, key=lambda influence: (-influence.share, influence.parameter))

    def _influence(self, column: SlopesColumn, k: int) -> Influence:
        effects = np.linalg.norm(0.01 * self.sizes[k] * column.slopes[:, :, k], axis=1)
        reached = np.isfinite(effects)
        effects = np.where(reached, effects, 0.0)
        effect = float(np.sqrt(np.sum(effects**2) / max(reached.sum(), 1)))
        scale = variation(column.values[reached])
        share = effect / scale if scale > 0 else (0.0 if effect == 0 else np.inf)
        return Influence(self.names[k], column.name, effect, share, float(self.ts[np.argmax(effects)]))

    def to_xarray(self) -> "xarray.Dataset":
        """Everything as a labelled data set.

        Each observable has three variables: its values, `sensitivity.NAME` and `normalized.NAME`, with the dimensions
        time, axis (or component), parameter.
        """
        return _dataset_of(self)

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write the data set: everything to netCDF (.nc), or a row for each sample to a table (.csv).

        Raises:
            SceneError: for another suffix, or a file that exists, unless `overwrite`.
        """
        from spherejax.output.io import save

        return save(self.to_xarray(), path, overwrite=overwrite)

    def figures(self) -> "dict[str, Figure]":
        """A figure for each observable, which parameter matters when, and one of the ranking (`"ranking"`)."""
        return _figures_of(self)

    def __str__(self) -> str:
        """What a person wants to know: which parameter matters, how much, when."""
        return _text_of(self)


def variation(values: Float[np.ndarray, "n c"]) -> float:
    """Root mean square along time of the distance from the mean; of the size itself where that does not vary."""
    if not len(values):
        return 0.0
    spread = float(np.sqrt(np.mean(np.sum((values - values.mean(0)) ** 2, 1))))
    size = float(np.sqrt(np.mean(np.sum(values**2, 1))))
    return spread if spread > 1e-9 * size else size


def _unknown(name: str, found: Sensitivities):
    known = ", ".join(repr(column.name) for column in found.columns)
    raise KeyError(f"{name!r} was not asked for; there are {known}")


# As a data set, as text, as pictures ----------------------------------------------------------------------------------


def _dataset_of(found: Sensitivities) -> "xarray.Dataset":
    """The data set; see `Sensitivities.to_xarray`."""
    import xarray

    variables, coordinates = {}, {}
    for column in found.columns:
        own, coordinate = _own_dims(column)
        coordinates.update(coordinate)
        shape = (len(found.ts), *([len(column.labels)] if own else []))
        unit, n = column.unit, len(found.names)
        slopes = column.slopes.reshape(*shape, n)
        per = f"{unit} per unit of the parameter" if unit else "per unit of the parameter"
        variables[column.name] = (("time", *own), column.values.reshape(shape), {"units": unit})
        variables[f"sensitivity.{column.name}"] = (
            ("time", *own, "parameter"), slopes, {"units": per, "long_name": f"d {column.name} / d parameter"}
        )  # fmt: skip
        variables[f"normalized.{column.name}"] = (
            ("time", *own, "parameter"), slopes * found.sizes,
            {"units": unit, "long_name": f"|parameter| d {column.name} / d parameter"}
        )  # fmt: skip
    coordinates = {
        "time": ("time", found.ts, {"units": "s", "long_name": "time"}),
        "parameter": found.names,
        "value": ("parameter", np.array(list(found.parameters.values())), {"long_name": "value of the parameter"}),
        **coordinates,
    }
    facts = {
        "derivative_mode": found.mode,  # SciPy, which xarray may write with, fails on files that have a `mode`
        "reason": found.reason,
        "method": found.method,
        "n_steps": found.n_steps,
        "seconds": found.seconds,
    }
    return xarray.Dataset(variables, coordinates, {**facts, "diagnosis": found.diagnosis or "none"})


def _own_dims(column: SlopesColumn) -> tuple[tuple[str, ...], dict[str, list[str]]]:
    n = len(column.labels)
    if n == 1:
        return (), {}
    name, labels = _OWN_DIMS.get(n, (f"{column.name}_0", tuple(map(str, range(n)))))
    return (name,), {name: list(labels)}


def _text_of(found: Sensitivities) -> str:
    """The text; see `Sensitivities.__str__`."""
    lines = [
        f"Sensitivities of {', '.join(column.name for column in found.columns)} by {len(found.names)} parameters, "
        f"in {found.mode} mode:",
        f"{found.reason}.",
        f"Integrated with {found.method}.",
    ]
    if found.diagnosis:
        lines.append(f"The run failed: {found.diagnosis}")
    ranking = found.ranking
    rows = [("parameter", "observable", "effect of 1 %", "of its variation", "largest at")]
    for each in ranking[:_SHOWN]:
        unit = found.column(each.observable).unit
        effect, share = f"{each.effect:.3g} {unit}".strip(), f"{100 * each.share:.3g} %"
        rows.append((each.parameter, each.observable, effect, share, f"{each.t_largest:.4g} s"))
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines += ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    if len(ranking) > _SHOWN:
        lines.append(f"... and {len(ranking) - _SHOWN} more, in .ranking")
    if np.any(np.array(list(found.parameters.values())) == 0):
        lines.append("For a parameter that is 0 the effect is that of a change by 0.01 of its unit.")
    return "\n".join(lines)


def _figures_of(found: Sensitivities) -> "dict[str, Figure]":
    """The figures; see `Sensitivities.figures`."""
    from spherejax.output.plot.sensitivities import EffectBars, effects_figure, ranking_figure

    figures: dict[str, Any] = {}
    order = [each for each in dict.fromkeys(influence.parameter for influence in found.ranking)]
    for column in found.columns:
        if len(found.ts) > 1:
            chosen = [found.names.index(name) for name in order]
            effects = 0.01 * column.slopes[:, :, chosen] * found.sizes[chosen]
            figures[column.name] = effects_figure(
                EffectBars(column.name, column.unit, found.ts, tuple(order), column.labels, effects)
            )
    figures["ranking"] = ranking_figure([(i.parameter, i.observable, i.share) for i in found.ranking])
    return figures
