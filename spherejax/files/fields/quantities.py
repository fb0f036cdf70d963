"""Numbers in files: plain ones in SI units, or texts with a unit of the right dimension."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from spherejax.files.fields.fields import Field, shown
from spherejax.files.fields.location import FilePlace
from spherejax.foundations.checks import is_concrete
from spherejax.foundations.errors import SceneError
from spherejax.foundations.units.units import PURE, UnitError, factor_of, in_si, measured

_WITHOUT_BRACKETS = str.maketrans("", "", "(){}")
"""For units that refer to others, e.g. `"({of_value})/({of_argument})"`, in lists."""


@dataclass(frozen=True)
class QuantityField(Field):
    """A number, or an array of numbers of one dimension.

    Attributes:
        si: SI unit, with words in braces that are filled in from the context; None takes any dimension.
        shapes: allowed shapes; -1 stands for any length. None takes any shape.
        shown: the unit in lists, where parts of the object decide on it; empty for `si`.
    """

    si: str | None
    shapes: tuple[tuple[int, ...], ...] | None = ((),)
    shown: str = ""

    @property
    def what(self) -> str:
        """The unit and the shape."""
        if self.shown:
            unit = self.shown
        elif self.si is None or self.si == PURE:
            unit = "any unit" if self.si is None else "-"
        else:
            unit = self.si.translate(_WITHOUT_BRACKETS).replace("of_", "")
        if self.shapes is None or self.shapes == ((),):
            return f"[{unit}]"
        return f"{' or '.join(_shape_text(shape) for shape in self.shapes)} [{unit}]"

    def unit(self, context):
        """The unit, filled in."""
        return context.unit(self.si)

    def read(self, value, place, context):
        """A float, or a float64 array."""
        unit = context.unit(self.si)
        if isinstance(value, str) and self.shapes is not None and () not in self.shapes:
            example = "[0, 0, 1]" if self.shapes == ((3,),) else "[...]"
            place.fail(f"{shown(value)} is one text; {self._expected(unit)} expected, written {example}")
        factor = None
        if isinstance(value, dict):
            if set(value) != {"values", "unit"} or not isinstance(value["unit"], str):
                place.fail('a table of numbers is written { values = [1.0, 2.0], unit = "mm" }')
            factor = _factor(value["unit"], unit, place / "unit")
            value, place = value["values"], place / "values"
        entries = _numbers(value, unit, place, factor)
        try:
            array = np.array(entries, np.float64)
        except ValueError:
            place.fail(f"rows of different lengths; {self._expected(unit)} expected")
        if self.shapes is not None and not any(_fits(array.shape, shape) for shape in self.shapes):
            given = "a single number" if array.ndim == 0 else _shape_text(array.shape)
            place.fail(f"{given}; {self._expected(unit)} expected")
        return float(array) if array.ndim == 0 else array

    def write(self, value, context):
        """A float, or nested lists of floats."""
        del context
        if not is_concrete(value):
            raise SceneError("a traced number cannot be written; write the scene outside jit, vmap and grad")
        return np.asarray(value, np.float64).tolist()

    def _expected(self, unit: str | None) -> str:
        what = "a number" if unit is None else measured(unit)
        assert self.shapes is not None
        shapes = [_shape_text(shape) for shape in self.shapes]
        return f"{what}, {' or '.join(shapes)}, is" if shapes != ["one number"] else f"{what} is"


def number(si: str | None) -> QuantityField:
    """One number."""
    return QuantityField(si)


def vector(si: str | None) -> QuantityField:
    """Three numbers."""
    return QuantityField(si, ((3,),))


def matrix(si: str | None) -> QuantityField:
    """Three rows of three numbers."""
    return QuantityField(si, ((3, 3),))


def listed(si: str | None) -> QuantityField:
    """Any number of numbers."""
    return QuantityField(si, ((-1,),))


@dataclass(frozen=True)
class Coefficients(Field):
    """The coefficients of a polynomial of `argument` that gives `value`: each has a dimension of its own."""

    @property
    def what(self) -> str:
        """A list."""
        return "a list of numbers [value/argument^k]"

    def read(self, value, place, context):
        """A float64 array."""
        if not isinstance(value, list) or not value:
            place.fail(f"{shown(value)} is not a list of coefficients, the lowest power first")
        entries = [number(self.si_of(k)).read(entry, place / k, context) for k, entry in enumerate(value)]
        return np.array(entries, np.float64)

    def write(self, value, context):
        """A list."""
        return listed(None).write(value, context)

    @staticmethod
    def si_of(power: int) -> str:
        """The SI unit of the coefficient of a power, with words in braces."""
        return "{of_value}" if power == 0 else f"({{of_value}})/({{of_argument}})^{power}"


@dataclass(frozen=True)
class Points(Field):
    """Points by name, three numbers each."""

    @property
    def what(self) -> str:
        """The table."""
        return "a table of names with three numbers each [m]"

    def read(self, value, place, context):
        """Arrays by name."""
        if not isinstance(value, dict):
            place.fail(f"{shown(value)} is not {self.what}; write points = {{ tip = [0.0, 0.0, 1.0] }}")
        return {name: vector("m").read(at, place / name, context) for name, at in value.items()}

    def write(self, value, context):
        """Lists by name."""
        return {name: vector("m").write(at, context) for name, at in value.items()}


def _numbers(value: Any, unit: str | None, place: FilePlace, factor: float | None):
    """Nested lists of SI numbers; with a factor they are plain ones in another unit."""
    if isinstance(value, list):
        return [_numbers(entry, unit, place / i, factor) for i, entry in enumerate(value)]
    if isinstance(value, str) and factor is None:
        try:
            return in_si(value, unit)
        except UnitError as error:
            place.fail(str(error))
    if isinstance(value, bool) or not isinstance(value, int | float):
        expected = "a number" if unit is None else measured(unit)
        place.fail(f"{shown(value)} is no number; {expected} is expected")
    try:
        return float(value) if factor is None else factor * float(value)
    except OverflowError:
        place.fail(f"{shown(value)} is larger than any number of 64 bits, 1.8e308")


def _factor(given: str, unit: str | None, place: FilePlace) -> float:
    try:
        return factor_of(given, unit)
    except UnitError as error:
        place.fail(str(error))


def _fits(shape: tuple[int, ...], allowed: tuple[int, ...]) -> bool:
    return len(shape) == len(allowed) and all(
        n == a or (a == -1 and n > 0) for n, a in zip(shape, allowed, strict=True)
    )


def _shape_text(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    if len(shape) == 1:
        return {-1: "a list of numbers", 1: "a list of one number"}.get(shape[0], f"{shape[0]} numbers")
    rows = "rows" if shape[0] == -1 else f"{shape[0]} rows"
    return f"{rows} of {shape[1]} numbers" if len(shape) == 2 else f"numbers of shape {shape}"
