"""Objects from tables and tables from objects: joints, models, laws, forces, materials, drift controls."""

import dataclasses
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import numpy as np

from spherejax.files.fields.code import reported
from spherejax.files.fields.dimensions import FIELDS
from spherejax.files.fields.fields import Context
from spherejax.files.fields.kinds import class_named, fields_of, is_needed, kind_of, kinds_of, parameters_of
from spherejax.files.fields.location import FilePlace
from spherejax.foundations.checks import Requirement, enforce, is_concrete
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.units.units import PURE, UnitError, in_si
from spherejax.physics.functions.base import ConvertedFunction, Given, UserFunction
from spherejax.physics.joints.dry import Dry
from spherejax.physics.joints.lubricated import Lubricated

KIND = "kind"
"""The key that names the class."""


def build(family: type, value: Any, place: FilePlace, context: Context) -> Any:
    """The object that a table describes; a text alone is the kind of an object with its defaults.

    `kind` may be left out where the family has one member only.
    """
    table = {KIND: value} if isinstance(value, str) else value
    if not isinstance(table, dict):
        place.fail(f'{value!r} is no {family.__name__.removeprefix("Abstract")}; write {{ kind = "...", ... }}')
    table = dict(table)
    members = kinds_of(family)
    kind = table.pop(KIND, next(iter(members)) if len(members) == 1 else None)
    if not isinstance(kind, str):
        place.fail(f'has no kind; write kind = "{next(iter(members), "my_file.py:MyClass")}"; {one_of(members, "")}')
    cls = class_named(kind, family, context, place / KIND if isinstance(value, dict) else place)
    if inspect.isfunction(cls):
        for key in table:
            (place / key).fail(f"the function {cls.__name__} has no numbers; write a class to give it some")
        return cls
    return built(cls, table, place, context)


def built(cls: type, table: Mapping[str, Any], place: FilePlace, context: Context) -> Any:
    """An object of a class from the arguments in a table, its values checked."""
    with reported(place, f"the arguments of {cls.__name__} are not known"):
        fields, parameters = fields_of(cls), parameters_of(cls)
    for key in table:
        if key not in fields:
            (place / key).fail(f"unknown key of {cls.__name__}; {one_of(fields, key)}")
    missing = [name for name, parameter in parameters.items() if is_needed(parameter) and name not in table]
    if missing:
        name = missing[0]
        place.fail(f"{cls.__name__} needs {name}, {fields[name].what}; add {name} = ...")
    inside = context._replace(words={**context.words, **_numbers_of(parameters, table)})
    # The parts that say the units of other arguments are read first: a coordinate says whether a gain is in N m/rad.
    ahead = {name: fields[name].read(table[name], place / name, inside) for name in _unit_givers(cls) if name in table}
    inside = inside._replace(words={**inside.words, **_words_of_parts(cls, ahead)})
    arguments = {
        name: ahead[name] if name in ahead else fields[name].read(value, place / name, inside)
        for name, value in table.items()
    }
    if cls not in FIELDS:
        with reported(place, f"{cls.__name__} cannot be made"):
            made = called(cls, arguments)
            check(made, place)
        return made
    try:
        made = called(cls, arguments)
    except (TypeError, ValueError) as error:
        place.fail(str(error))
    check(made, place)
    return made


def called(cls: type, arguments: Mapping[str, Any]) -> Any:
    """`cls(**arguments)`; an argument like `*terms` is a list."""
    many = [name for name, p in parameters_of(cls).items() if p.kind is inspect.Parameter.VAR_POSITIONAL]
    listed = [entry for name in many for entry in arguments.get(name, ())]
    return cls(*listed, **{name: value for name, value in arguments.items() if name not in many})


def check(made: Any, place: FilePlace) -> None:
    """Judge the values of an object; the error names the key."""
    requirements: list[Requirement] = made.requirements() if hasattr(made, "requirements") else []
    for requirement in requirements:
        key = requirement.field.rpartition(".")[2]
        at = place / key if (*place.keys, key) in place.source.lines else place
        try:
            enforce(type(made).__name__, [requirement])
        except SceneError as error:
            at.fail(str(error))


def describe(made: Any, family: type, context: Context) -> dict[str, Any]:
    """The table that describes an object.

    Raises:
        SceneError: for an object that no table gives back, or that contains a Python function.
    """
    if inspect.isfunction(made):
        return {KIND: kind_of(made, context.folder)}
    cls = type(made)
    if not isinstance(made, eqx.Module):
        raise SceneError(_no_table(made, family))
    table: dict[str, Any] = {KIND: kind_of(cls, context.folder)}
    if list(kinds_of(family).values()) == [cls]:
        del table[KIND]
    return {**table, **described(made, context)}


def described(made: Any, context: Context) -> dict[str, Any]:
    """The arguments of an object as a table, without those that are None or have their default's value."""
    fields, arguments = fields_of(type(made)), arguments_of(made)
    words = {**_numbers_of(parameters_of(type(made)), arguments), **_words_of_parts(type(made), arguments)}
    inside = context._replace(words={**context.words, **words})
    table = {name: fields[name].write(value, inside) for name, value in arguments.items()}
    if not _gives_back(arguments, made):
        raise SceneError(
            f"{type(made).__name__} is not given back by its attributes; keep each argument of its constructor in an "
            "attribute of the same name"
        )
    return {name: table[name] for name in _without_defaults(made, arguments)}


def _gives_back(arguments: Mapping[str, Any], made: Any) -> bool:
    """Whether the constructor makes the same object from these arguments."""
    try:
        return same(called(type(made), arguments), made)
    except (TypeError, ValueError):
        return False


def _without_defaults(made: Any, arguments: dict[str, Any]) -> dict[str, Any]:
    """The arguments that a file must say, for all others come from the defaults of the constructor.

    An argument is left out only if the object is the same without it: so are defaults that a factory makes or that
    follow from other arguments. What says the units of other arguments stays, for a reader takes units from the file.
    """
    stays = set(_unit_givers(type(made)))
    for name, parameter in parameters_of(type(made)).items():
        if name in arguments and name not in stays and not is_needed(parameter):
            fewer = {key: value for key, value in arguments.items() if key != name}
            arguments = fewer if _gives_back(fewer, made) else arguments
    return arguments


def arguments_of(made: Any) -> dict[str, Any]:
    """The arguments that make an object again, by name; None is left out."""
    found = {name: unwrapped(_attribute(made, name)) for name in parameters_of(type(made))}
    if isinstance(made, Dry | Lubricated) and made._ball_radius_given:
        found = {**found, "clearance": None, "ball_radius": _ball_radius(made)}
    return {name: value for name, value in found.items() if value is not None}


def _attribute(made: Any, name: str) -> Any:
    """What was given as the argument `name`; a place may have been given by its name."""
    value = getattr(made, name, None)
    return getattr(made, f"{name}_name", None) if value is None else value


def unwrapped(value: Any) -> Any:
    """The function that a user gave, without what it was wrapped in."""
    while type(value) in WRAPPERS:
        value = next(inner for inner in WRAPPERS[type(value)](value) if inner is not None)
    return tuple(unwrapped(entry) for entry in value) if isinstance(value, tuple) else value


WRAPPERS: Mapping[type, Callable[[Any], tuple]] = {
    Given: lambda given: (given.callable,),
    UserFunction: lambda function: (function.given,),
    ConvertedFunction: lambda function: (function.given,),
}
"""Classes in which functions of users are kept."""


def same(first: Any, second: Any) -> bool:
    """Whether two objects have the same classes, names and numbers, to the last bit."""
    if dataclasses.is_dataclass(first) and dataclasses.is_dataclass(second):
        names = [field.name for field in dataclasses.fields(first)]
        return type(first) is type(second) and all(same(getattr(first, n), getattr(second, n)) for n in names)
    if isinstance(first, tuple) and isinstance(second, tuple) and not _is_numeric(first):
        return len(first) == len(second) and all(same(a, b) for a, b in zip(first, second, strict=True))
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return set(first) == set(second) and all(same(first[key], second[key]) for key in first)
    numeric = [_is_numeric(first), _is_numeric(second)]
    if all(numeric):
        return np.array_equal(np.asarray(first), np.asarray(second), equal_nan=True)
    # An array compared with None has a truth value for each entry.
    return not any(numeric) and first == second


def _ball_radius(model: Dry | Lubricated) -> float:
    """The radius R_j that gives the clearance back to the last bit: c = R_i - R_j is rounded."""
    given, clearance = float(model.socket_radius), float(model.clearance)
    radius = given - clearance
    for candidate in (radius, np.nextafter(radius, -np.inf), np.nextafter(radius, np.inf)):
        if given - candidate == clearance:
            return float(candidate)
    raise SceneError(f"ball_radius: no radius gives the clearance {clearance!r} back; give clearance= instead")


def _is_numeric(value: Any) -> bool:
    if isinstance(value, str | bool) or value is None or not is_concrete(value):
        return False
    try:
        return np.asarray(value).dtype.kind in "fiu"
    except (TypeError, ValueError):
        return False


def _numbers_of(parameters: Mapping[str, inspect.Parameter], table: Mapping[str, Any]) -> dict[str, Any]:
    """Numbers of a table, or their defaults, that the units of its other numbers may refer to.

    A text is one as well, `exponent = "1.5"`: without it, the unit would be unknown and any dimension would pass.
    """
    values = {name: table.get(name, parameter.default) for name, parameter in parameters.items()}
    return {name: text for name, value in values.items() if (text := _power_in_unit(value)) is not None}


def numbers_in_units(made: Any) -> dict[str, Any]:
    """What the units of an object's numbers may refer to: numbers of it, e.g. its exponent, and units by its parts."""
    values = {field.name: getattr(made, field.name) for field in dataclasses.fields(made)}
    return {**_numbers_of(parameters_of(type(made)), values), **_words_of_parts(type(made), values)}


def _unit_givers(cls: type) -> tuple[str, ...]:
    """Arguments that say the units of others: those of the static method `unit_words` of the class, if it has one."""
    teller = getattr(cls, "unit_words", None)
    return () if teller is None else tuple(inspect.signature(teller).parameters)


def _words_of_parts(cls: type, arguments: Mapping[str, Any]) -> dict[str, str]:
    """Units by name that an object's parts give to its numbers."""
    parts = {name: arguments[name] for name in _unit_givers(cls) if name in arguments}
    return cls.unit_words(**parts) if parts else {}  # pyright: ignore[reportAttributeAccessIssue]


def _power_in_unit(value: Any) -> str | None:
    """A number as it stands in the unit of another, `N/m^{exponent}`; None for what is no power of a unit."""
    if isinstance(value, str):
        try:
            value = in_si(value, PURE)
        except UnitError:
            return None
    is_power = type(value) in (int, float, np.float64) and abs(value) < 1e6
    return f"{value:g}" if is_power else None


def _no_table(made: Any, family: type) -> str:
    what = family.__name__.removeprefix("Abstract")
    if callable(made):
        return (
            f"a Python function cannot be written to a file; take a {what} of the package instead, or a class of your "
            'own in a file, kind = "my_file.py:MyClass"'
        )
    return f"{made!r} is no {what}"
