"""Objects inside of objects: models, laws, materials, curves, functions."""

from dataclasses import dataclass

import numpy as np

from spherejax.files.fields.fields import Context, Field, shown, words_of
from spherejax.files.fields.quantities import QuantityField
from spherejax.foundations.units.number_texts import looks_like_number


class OwnFunction:
    """Stands for a function that only a user can write, of several arguments or with several values: files name it by
    "my_file.py:my_function", or by a class whose objects can be called.
    """


@dataclass(frozen=True)
class PartField(Field):
    """An object of its own: a model, a law, a material, a function.

    Attributes:
        family: the class that it is one of.
        argument: for a function, the SI unit of its argument.
        value: for a function, the SI unit of its value.
        shown: that unit in lists, where parts of the object decide on it; empty for `value`.
    """

    family: type
    argument: str | None = None
    value: str | None = None
    shown: str = ""

    @property
    def what(self) -> str:
        """The family."""
        units = "" if self.argument is None else f", [{self.shown or self.value}] by [{self.argument}]"
        family = words_of(self.family)
        if self.family is OwnFunction:
            return "a function of your own"
        return f"{'an' if family[0] in 'aeiou' else 'a'} {family}{units}"

    def read(self, value, place, context):
        """The object."""
        return context.build(self.family, value, place, self.inside(context))

    def write(self, value, context):
        """A table with the kind."""
        return context.describe(value, self.family, self.inside(context))

    def inside(self, context: Context) -> Context:
        """What the units of the object's own numbers may refer to."""
        units = {"of_argument": context.unit(self.argument), "of_value": context.unit(self.value)}
        return context._replace(words={name: unit for name, unit in units.items() if unit is not None})


@dataclass(frozen=True)
class PartsField(Field):
    """A list of objects of one family, with the dimensions of the function that holds them."""

    family: type

    @property
    def what(self) -> str:
        """The family."""
        return f"a list, each a {words_of(self.family)}"

    def read(self, value, place, context):
        """A tuple of objects."""
        if not isinstance(value, list):
            place.fail(f"{shown(value)} is not {self.what}")
        return tuple(context.build(self.family, entry, place / i, context) for i, entry in enumerate(value))

    def write(self, value, context):
        """A list of tables."""
        return [context.describe(entry, self.family, context) for entry in value]


@dataclass(frozen=True)
class Either(Field):
    """The first of several fields that fits the form of the value: numbers are written as numbers, lists, or texts with
    a unit, objects as tables with a `kind`, or as this word alone."""

    quantity: QuantityField
    part: PartField

    @property
    def what(self) -> str:
        """Both."""
        return f"{self.quantity.what}, or {self.part.what}"

    def unit(self, context):
        """The unit of the number."""
        return self.quantity.unit(context)

    def read(self, value, place, context):
        """The number or the object."""
        # "300 rpm" is a number, "sine" a kind, and "2nd_laws.py:MyForce" a class of a user's own.
        is_word = isinstance(value, str) and (":" in value or not looks_like_number(value.strip()))
        is_part = is_word or (isinstance(value, dict) and "values" not in value)
        return (self.part if is_part else self.quantity).read(value, place, context)

    def write(self, value, context):
        """The number or the table."""
        is_number = isinstance(value, np.ndarray | float | int) or hasattr(value, "dtype")
        return (self.quantity if is_number else self.part).write(value, context)
