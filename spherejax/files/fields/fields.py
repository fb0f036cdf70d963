"""What an argument of a constructor holds: how it is read from a file and written to it."""

import abc
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from spherejax.files.fields.location import FilePlace
from spherejax.foundations.errors import one_of
from spherejax.foundations.units.units import simplified


class Context(NamedTuple):
    """What is known around a value.

    Attributes:
        folder: of the file: paths in it are relative to this.
        points: names of the points of each body, the ground included.
        words: what the units of a field may refer to: numbers of the same table (`exponent`), and of a function the
            units of its argument and its value (`of_argument`, `of_value`).
        build: makes the object that a table describes: from a family, a value, a place and a context.
        describe: the reverse: from an object, a family and a context to a table.
        allow_code: whether kinds of users' own, which run Python code, may be read.
    """

    folder: Path
    points: Mapping[str, tuple[str, ...]]
    words: Mapping[str, Any]
    build: Callable[..., Any]
    describe: Callable[..., Any]
    allow_code: bool = False

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
    def read(self, value: Any, place: FilePlace, context: Context) -> Any:
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
            place.fail(f"{shown(value)} is not {self.what}")
        if self.kind is int and abs(value) >= 2**63:
            place.fail(f"{shown(value)} is larger than any whole number of 64 bits, 9.2e18")
        return value

    def write(self, value, context):
        """The value as a plain one."""
        return self.kind(value)


@dataclass(frozen=True)
class ChoiceField(Field):
    """One of several words."""

    names: tuple[str, ...]

    @property
    def what(self) -> str:
        """The words."""
        return ", ".join(self.names)

    def read(self, value, place, context):
        """The word."""
        if value not in self.names:
            place.fail(f"{shown(value)} is unknown; {one_of(self.names, str(value))}")
        return value


def words_of(family: type) -> str:
    """What members of a family are called, e.g. `"normal law"`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", family.__name__.removeprefix("Abstract")).lower()


def shown(value: Any) -> str:
    """A value for a message, not too long."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no integer of more than 4,300 digits
        return f"a number of more than {sys.get_int_max_str_digits()} digits"
    return text if len(text) < 60 else f"{text[:57]}..."
