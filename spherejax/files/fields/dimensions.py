"""What each argument of each class holds, with its unit, as the annotations of its constructor say it.

A class describes itself: `v1: Annotated[Number, Unit("m/s")]` beside its formula is all that files, lists and the
command line know of a number. See the marks in `foundations.types`.
"""

import importlib
import inspect
import pkgutil
import types
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, Union, get_args, get_origin

import equinox as eqx

from spherejax.files.fields.fields import Field, Plain
from spherejax.files.fields.names import BodyName, BodyNames, End, Ends, PointName, PointOrPlace
from spherejax.files.fields.parts import Either, OwnFunction, PartField, PartsField
from spherejax.files.fields.quantities import Coefficients, Points, QuantityField
from spherejax.foundations.types import COEFFICIENTS, OWN, Function, Named, Shaped, Unit
from spherejax.model import drift
from spherejax.physics import forces, functions, joints, laws
from spherejax.physics.bodies import Body
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.forces.coupler import AbstractCoordinate
from spherejax.physics.functions.base import AbstractFunction, ConvertedFunction, UserFunction
from spherejax.physics.joints.base import AbstractSphericalModel
from spherejax.physics.joints.curves import AbstractCurve
from spherejax.physics.joints.joint import AbstractJoint
from spherejax.physics.laws.base import AbstractLaw
from spherejax.physics.laws.depth import AbstractDepth

Fields = Mapping[str, Field]

NAMES: Mapping[Named, Field] = {
    Named.BODY: BodyName(),
    Named.BODIES: BodyNames(),
    Named.POINT: PointName(),
    Named.END: End(),
    Named.ENDS: Ends(),
    Named.PLACE: PointOrPlace(),
}


def parameters_of(cls: type) -> dict[str, inspect.Parameter]:
    """The arguments of a class's constructor."""
    return {
        name: parameter
        for name, parameter in inspect.signature(cls).parameters.items()
        if parameter.kind is not inspect.Parameter.VAR_KEYWORD
    }


def described_field(parameter: inspect.Parameter) -> Field | None:
    """What an argument holds, as its annotation says; None where that says nothing that files know."""
    marks = getattr(parameter.annotation, "__metadata__", ())
    kind = _without_none(get_args(parameter.annotation)[0] if marks else parameter.annotation)
    marks = (*marks, *getattr(kind, "__metadata__", ()))
    mark = next((mark for mark in marks if isinstance(mark, Unit)), None)
    unit, shown = (None, "") if mark is None else mark
    function = next((mark for mark in marks if isinstance(mark, Function)), None)
    if function is not None and unit is not None:
        return Either(QuantityField(unit, ((),), shown), _function_field(function))
    if function is not None:
        is_many = parameter.kind is inspect.Parameter.VAR_POSITIONAL or (get_origin(kind) or kind) is Sequence
        return PartsField(AbstractFunction) if is_many else _function_field(function)
    if unit is not None:
        if (get_origin(kind) or kind) is Mapping:
            return Points()
        shapes = next((mark.shapes for mark in marks if isinstance(mark, Shaped)), _shapes_of(kind))
        quantity = QuantityField(unit, ((3,),) if OWN in marks else shapes, shown)
        return Either(quantity, PartField(OwnFunction)) if OWN in marks else quantity
    if OWN in marks:
        return PartField(OwnFunction)
    if COEFFICIENTS in marks:
        return Coefficients()
    named = next((NAMES[mark] for mark in marks if isinstance(mark, Named)), None)
    if named is not None or kind in (bool, str, int):
        return named or Plain(kind)
    is_family = inspect.isclass(kind) and eqx.Module in kind.__mro__
    return PartField(kind) if is_family else None


def _function_field(function: Function) -> PartField:
    return PartField(AbstractFunction, *function)


def _without_none(annotation: Any) -> Any:
    """The class in `X | None`."""
    if get_origin(annotation) not in (Union, types.UnionType):
        return annotation
    options = [option for option in get_args(annotation) if option is not types.NoneType]
    return options[0] if len(options) == 1 else annotation


def _shapes_of(kind: Any) -> tuple[tuple[int, ...], ...] | None:
    """Of what no mark says the shape of: an array by its annotation, or one number; None for anything."""
    if kind is Any:
        return None
    sizes = getattr(kind, "dim_str", "").split()
    return (tuple(int(size) if size.isdigit() else -1 for size in sizes),)


def _described(cls: type) -> Fields:
    found = {name: described_field(parameter) for name, parameter in parameters_of(cls).items()}
    dumb = [name for name, field in found.items() if field is None]
    assert not dumb, f"{cls.__name__}: nothing says what {', '.join(dumb)} holds; annotate its unit or its kind"
    return {name: field for name, field in found.items() if field is not None}


FOLDERS: Mapping[ModuleType, tuple[type, ...]] = {
    joints: (AbstractJoint, AbstractCurve, AbstractSphericalModel),
    laws: (AbstractLaw, AbstractDepth),
    forces: (AbstractForce, AbstractCoordinate),
    functions: (AbstractFunction,),
}
"""Where the kinds of parts are, and what they are."""


def _kinds() -> list[type]:
    """The classes that a file can name: all of the package that are no helpers and can be made."""
    found: list[type] = [Body]
    for folder, families in FOLDERS.items():
        for file in pkgutil.iter_modules(folder.__path__, f"{folder.__name__}."):
            found += _of_module(importlib.import_module(file.name), families)
    return found + _of_module(drift, (drift.AbstractDriftControl,))


def _of_module(module: ModuleType, families: tuple[type, ...]) -> list[type]:
    own = [cls for cls in vars(module).values() if inspect.isclass(cls) and cls.__module__ == module.__name__]
    return [
        cls
        for cls in own
        if issubclass(cls, families)
        and not cls.__name__.startswith(("Abstract", "_"))
        and cls not in (UserFunction, ConvertedFunction)
    ]


FIELDS: Mapping[type, Fields] = {cls: _described(cls) for cls in _kinds()}
"""The arguments of every class that a file can name."""
