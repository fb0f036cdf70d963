"""Answers in the units in which their numbers were given: `--clearance "0.1 mm"` is answered in millimetres."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.units import PURE, UnitError, factor_of, unit_in

if TYPE_CHECKING:
    import xarray

    import spherejax as sj


class ShownNumbers(NamedTuple):
    """How the numbers of a parameter are told.

    Attributes:
        unit: in which; empty where none is known, or of pure numbers.
        factor: what numbers in it are multiplied by to be in SI units.
    """

    unit: str = ""
    factor: float = 1.0

    def head(self, name: str) -> str:
        """A name with the unit."""
        return f"{name} [{self.unit}]" if self.unit else name

    def of(self, values: xarray.DataArray) -> tuple[Any, Any, dict[str, Any]]:
        """Numbers in SI units in the unit: dimensions, values, attributes."""
        told = values.values if self.factor == 1.0 else values.values / self.factor
        return values.dims, told, {**values.attrs, "units": self.unit or PURE}


def shown_in(texts: Iterable[str], si: str | None) -> ShownNumbers:
    """The unit of the first text that has one, else that of SI.

    Args:
        texts: numbers as they were given.
        si: the unit of SI that the texts have been judged by; None where it is not known.
    """
    given = next(filter(None, map(unit_in, texts)), "")
    if given:
        return ShownNumbers(given, factor_of(given, si))
    return ShownNumbers("" if si in (None, PURE) else str(si))


class WantedQuantity(NamedTuple):
    """A quantity as it is asked for, with the unit in which it is told.

    Attributes:
        name: the quantity, as "reaction.elbow" or "final position.rocker".
        unit: in which it is told; empty: in SI units.
    """

    name: str
    unit: str = ""

    def shown(self, si: str) -> ShownNumbers:
        """How it is told.

        Raises:
            SceneError: for a unit of another dimension.
        """
        if not self.unit:
            return ShownNumbers(si)
        try:
            return ShownNumbers(self.unit, factor_of(self.unit, si or PURE))
        except UnitError as error:
            raise SceneError(f"{self.name} [{self.unit}]: {error}") from None


def wanted(text: str) -> WantedQuantity:
    """A quantity with a unit in brackets, "reaction.elbow [kN]", or without."""
    name, bracket, unit = text.strip().removesuffix("]").partition("[")
    return WantedQuantity(name.strip(), unit.strip() if bracket else "")


def in_units(dataset: xarray.Dataset, shown: Mapping[str, ShownNumbers]) -> xarray.Dataset:
    """The result of a sweep with its parameters in the units in which they are told."""
    return dataset.assign_coords({key: one.of(dataset[key]) for key, one in shown.items()})


def sensitivities_in_units(
    found: sj.studies.Sensitivities, asked: Sequence[WantedQuantity]
) -> sj.studies.Sensitivities:
    """Derivatives with what is observed in the units in which it was asked for."""
    units = {one.name: one for one in asked}
    shown = [(column, units[column.name].shown(column.unit)) for column in found.columns]
    columns = [
        replace(column, unit=how.unit, values=column.values / how.factor, slopes=column.slopes / how.factor)
        for column, how in shown
    ]
    return replace(found, columns=tuple(columns))
