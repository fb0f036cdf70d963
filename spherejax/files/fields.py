"""What the fields of bodies, joints, models, laws and forces hold: how each is read from a file and written to it."""

import abc
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from spherejax.files.place import Place, one_of
from spherejax.files.units import PURE, UnitError, in_si, measured, simplified
from spherejax.foundations.checks import SceneError, is_concrete
from spherejax.physics.bodies import GROUND


class Context(NamedTuple):
    """What is known around a value.

    Attributes:
        folder: of the file: paths in it are relative to this.
        points: names of the points of each body, the ground included.
        words: what the units of a field may refer to: numbers of the same table (`exponent`), and the dimensions of
            `argument` and `value` of a function.
        build: makes the object that a table describes: from a family, a value, a place and a context.
        describe: the reverse: from an object, a family and a context to a table.
    """

    folder: Path
    points: Mapping[str, tuple[str, ...]]
    words: Mapping[str, Any]
    build: Callable[..., Any]
    describe: Callable[..., Any]

    def unit(self, unit: str | None) -> str | None:
        """A unit with its words filled in; None when one of them is not known."""
        if unit is None:
            return None
        try:
            return simplified(unit.format(**self.words))
        except KeyError:
            return None


class Field(abc.ABC):
    """What one argument of a constructor holds."""

    @abc.abstractmethod
    def read(self, value: Any, place: Place, context: Context) -> Any:
        """The argument from the value in the file; `place.fail` for a wrong one."""

    def write(self, value: Any, context: Context) -> Any:
        """The value in the file from the argument."""
        del context
        return value

    def unit(self, context: Context) -> str | None:
        """The SI unit, for a comment beside the value."""
        del context
        return None

    @property
    @abc.abstractmethod
    def what(self) -> str:
        """What is expected, for lists and messages."""


@dataclass(frozen=True)
class Quantity(Field):
    """A number, or an array of numbers of one dimension.

    Attributes:
        si: SI unit, with words in braces that are filled in from the context; None takes any dimension.
        shapes: allowed shapes; -1 stands for any length. None takes any shape.
    """

    si: str | None
    shapes: tuple[tuple[int, ...], ...] | None = ((),)

    @property
    def what(self) -> str:
        """The unit and the shape."""
        unit = "any unit" if self.si is None else "-" if self.si == PURE else self.si
        if self.shapes is None or self.shapes == ((),):
            return f"[{unit}]"
        return f"{' or '.join(_shape_text(shape) for shape in self.shapes)} [{unit}]"

    def unit(self, context):
        """The unit, filled in."""
        return context.unit(self.si)

    def read(self, value, place, context):
        """A float, or a float64 array."""
        unit = context.unit(self.si)
        if isinstance(value, dict):
            value, unit_given, place = _with_one_unit(value, place)
            value = _with_unit(value, unit_given)
        entries = _numbers(value, unit, place)
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


def number(si: str | None) -> Quantity:
    """One number."""
    return Quantity(si)


def vector(si: str | None) -> Quantity:
    """Three numbers."""
    return Quantity(si, ((3,),))


def matrix(si: str | None) -> Quantity:
    """Three rows of three numbers."""
    return Quantity(si, ((3, 3),))


def listed(si: str | None) -> Quantity:
    """Any number of numbers."""
    return Quantity(si, ((-1,),))


@dataclass(frozen=True)
class Plain(Field):
    """A truth value, a whole number or a text, as TOML has them."""

    kind: type

    @property
    def what(self) -> str:
        """The kind."""
        return {bool: "true or false", int: "a whole number", str: "a text"}[self.kind]

    def read(self, value, place, context):
        """The value, if it is of the kind."""
        del context
        if type(value) is not self.kind:
            place.fail(f"{_shown(value)} is not {self.what}")
        return value

    def write(self, value, context):
        """The value as a plain one."""
        return self.kind(value)


@dataclass(frozen=True)
class Choice(Field):
    """One of several words."""

    names: tuple[str, ...]

    @property
    def what(self) -> str:
        """The words."""
        return ", ".join(self.names)

    def read(self, value, place, context):
        """The word."""
        if value not in self.names:
            place.fail(f"{_shown(value)} is unknown; {one_of(self.names, str(value))}")
        return value


@dataclass(frozen=True)
class BodyName(Field):
    """The name of a body, the ground included."""

    @property
    def what(self) -> str:
        """A name."""
        return "a body"

    def read(self, value, place, context):
        """A body that exists."""
        if not isinstance(value, str):
            place.fail(f"{_shown(value)} is no body's name")
        if value not in context.points:
            place.fail(f"there is no body {value!r}; {one_of(context.points, value)}")
        return value


@dataclass(frozen=True)
class BodyNames(Field):
    """Names of bodies: two, or any number."""

    n: int | None = 2

    @property
    def what(self) -> str:
        """Two names."""
        return "two bodies" if self.n == 2 else "bodies"

    def read(self, value, place, context):
        """Bodies that exist."""
        if not isinstance(value, list) or (self.n is not None and len(value) != self.n):
            place.fail(f'{_shown(value)} is not a list of {self.what}; write ["{GROUND}", "arm"]')
        return tuple(BodyName().read(name, place / i, context) for i, name in enumerate(value))

    def write(self, value, context):
        """A list."""
        return list(value)


@dataclass(frozen=True)
class PointName(Field):
    """`"body.point"`."""

    @property
    def what(self) -> str:
        """How it is written."""
        return '"body.point"'

    def read(self, value, place, context):
        """A point that exists."""
        if not isinstance(value, str) or "." not in value:
            place.fail(f'{_shown(value)} is no point; write "body.point", e.g. {self._example(context)}')
        body, _, point = value.partition(".")
        if body not in context.points:
            place.fail(f"{value!r}: there is no body {body!r}; {one_of(context.points, body)}")
        if point not in context.points[body]:
            table = "ground_points" if body == GROUND else f"bodies.{body}.points"
            known = one_of(context.points[body], point)
            place.fail(f"{value!r}: body {body!r} has no point {point!r}; {known}. Add it to [{table}]")
        return value

    @staticmethod
    def _example(context: Context) -> str:
        return next((f'"{b}.{p}"' for b, points in context.points.items() for p in points), '"arm.tip"')


@dataclass(frozen=True)
class Part(Field):
    """An object of its own: a model, a law, a material, a function.

    Attributes:
        family: the class that it is one of.
        argument: for a function, the SI unit of its argument.
        value: for a function, the SI unit of its value.
    """

    family: type
    argument: str | None = None
    value: str | None = None

    @property
    def what(self) -> str:
        """The family."""
        return f"a {words_of(self.family)}"

    def read(self, value, place, context):
        """The object."""
        return context.build(self.family, value, place, self._inside(context))

    def write(self, value, context):
        """A table with the kind."""
        return context.describe(value, self.family, self._inside(context))

    def _inside(self, context: Context) -> Context:
        units = {"argument": context.unit(self.argument), "value": context.unit(self.value)}
        return context._replace(words={name: unit for name, unit in units.items() if unit is not None})


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
            place.fail(f"{_shown(value)} is not {self.what}; write points = {{ tip = [0.0, 0.0, 1.0] }}")
        return {name: vector("m").read(at, place / name, context) for name, at in value.items()}

    def write(self, value, context):
        """Lists by name."""
        return {name: vector("m").write(at, context) for name, at in value.items()}


@dataclass(frozen=True)
class Either(Field):
    """The first of several fields that fits the form of the value: numbers are written as numbers or lists, objects as
    tables with a `kind`."""

    quantity: Quantity
    part: Part

    @property
    def what(self) -> str:
        """Both."""
        return f"{self.quantity.what}, or {self.part.what}"

    def unit(self, context):
        """The unit of the number."""
        return self.quantity.unit(context)

    def read(self, value, place, context):
        """The number or the object."""
        is_part = isinstance(value, dict) and "values" not in value
        return (self.part if is_part else self.quantity).read(value, place, context)

    def write(self, value, context):
        """The number or the table."""
        is_number = is_concrete(value) and not isinstance(value, eqx.Module) and not callable(value)
        return (self.quantity if is_number else self.part).write(value, context)


def words_of(family: type) -> str:
    """What members of a family are called, e.g. `"normal law"`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", family.__name__.removeprefix("Abstract")).lower()


def _numbers(value: Any, unit: str | None, place: Place):
    """Nested lists of SI numbers."""
    if isinstance(value, list):
        return [_numbers(entry, unit, place / i) for i, entry in enumerate(value)]
    if isinstance(value, str):
        try:
            return in_si(value, unit)
        except UnitError as error:
            place.fail(str(error))
    if isinstance(value, bool) or not isinstance(value, int | float):
        expected = "a number" if unit is None else measured(unit)
        place.fail(f"{_shown(value)} is no number; {expected} is expected")
    return float(value)


def _with_one_unit(value: dict, place: Place):
    if set(value) != {"values", "unit"} or not isinstance(value["unit"], str):
        place.fail('a table of numbers is written { values = [1.0, 2.0], unit = "mm" }')
    return value["values"], value["unit"], place / "values"


def _with_unit(value: Any, unit: str):
    if isinstance(value, list):
        return [_with_unit(entry, unit) for entry in value]
    return f"{value!r} {unit}" if type(value) in (int, float) else value


def _fits(shape: tuple[int, ...], allowed: tuple[int, ...]) -> bool:
    return len(shape) == len(allowed) and all(
        n == a or (a == -1 and n > 0) for n, a in zip(shape, allowed, strict=True)
    )


def _shape_text(shape: tuple[int, ...]) -> str:
    if not shape:
        return "one number"
    if len(shape) == 1:
        return "a list of numbers" if shape[0] == -1 else f"{shape[0]} numbers"
    return f"{shape[0]} rows of {shape[1]} numbers" if len(shape) == 2 else f"numbers of shape {shape}"


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) < 60 else f"{text[:57]}..."
