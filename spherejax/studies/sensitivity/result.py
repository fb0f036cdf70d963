"""The result of an analysis of sensitivities: derivatives along time, which parameter matters when, and pictures."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


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
class Column:
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
    columns: tuple[Column, ...]
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

    def column(self, name: str) -> Column:
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

    def _influence(self, column: Column, k: int) -> Influence:
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
        from spherejax.studies.sensitivity.table import dataset_of

        return dataset_of(self)

    def save(self, path: str | os.PathLike, *, overwrite: bool = False) -> Path:
        """Write the data set: everything to netCDF (.nc), or a row for each sample to a table (.csv).

        Raises:
            SceneError: for another suffix, or a file that exists, unless `overwrite`.
        """
        from spherejax.output.io import save

        return save(self.to_xarray(), path, overwrite=overwrite)

    def figures(self) -> "dict[str, Figure]":
        """A figure for each observable, which parameter matters when, and one of the ranking (`"ranking"`)."""
        from spherejax.studies.sensitivity.table import figures_of

        return figures_of(self)

    def __str__(self) -> str:
        """What a person wants to know: which parameter matters, how much, when."""
        from spherejax.studies.sensitivity.table import text_of

        return text_of(self)


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
