"""The form of a value: one number, three numbers, a model, a name. Said once, as the annotation of its field.

A scene is walked along its fields before any number in it is looked at: what has another form is named with its place
and a remedy. NumPy would make numbers of texts, of truth values and of times, drop the imaginary part of a complex
number, and stretch one number over three axes; the mechanism would be another one, in silence.
"""

import dataclasses
import datetime
import inspect
import re
import types
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from numbers import Real
from typing import Any, NamedTuple, Union, get_args, get_origin

import equinox as eqx
import jax
import jax.core
import numpy as np

from spherejax.foundations.checks import Requirement, shown
from spherejax.foundations.errors import SceneError
from spherejax.foundations.types import Matrix3, Scalar, Shaped

WORDS = {
    (): "one number",
    (3,): "three numbers",
    (4,): "four numbers",
    (3, 3): "three rows of three numbers",
    (-1,): "a list of numbers",
    (-1, 3): "rows of three numbers",
}
"""Shapes in words; -1 stands for any length above zero."""

EXAMPLES = {
    ((),): "Give the number alone, in SI units.",
    ((3,),): "Write e.g. (0.0, 0.0, 1.0), in SI units.",
    ((4,),): "Write e.g. (1.0, 0.0, 0.0, 0.0), the scalar part first.",
    ((3, 3),): "Write three rows, in SI units.",
    ((3,), (3, 3)): "Write e.g. (1e-3, 1e-3, 1e-3) for the principal moments, or a symmetric matrix, in SI units.",
}
"""What to write."""

_AXES = {"x": "(1.0, 0.0, 0.0)", "y": "(0.0, 1.0, 0.0)", "z": "(0.0, 0.0, 1.0)"}

IN_SI = "Give it in SI units."


class _Given(NamedTuple):
    """What a value is where a number is expected; `shape` is None where it is none."""

    shape: tuple[int, ...] | None
    remedy: str


def malformed(part: Any, path: str = "") -> Iterator[Requirement]:
    """Requirements, all of them violated, for fields of an object, and of objects in it, that have another form.

    Args:
        part: a dataclass: a body, a joint, a law; fields are judged whose annotation says a form.
        path: what stands in front of the names of its fields, e.g. `"model."`.
    """
    for field in dataclasses.fields(part):
        yield from of_form(path + field.name, getattr(part, field.name, None), field.type)


def of_form(name: str, value: Any, annotation: Any) -> Iterator[Requirement]:
    """A violated requirement for a value that has not the form that an annotation says."""
    marks = getattr(annotation, "__metadata__", ())
    if marks and not any(isinstance(mark, Shaped) for mark in marks):
        annotation = get_args(annotation)[0]  # a unit, or what a name names: nothing of the form
    options = _options_of(annotation)
    if value is None and types.NoneType in options:
        return
    # By its bases: `issubclass` asks all modules that there are, which takes a tenth of a second.
    families = tuple(one for one in options if inspect.isclass(one) and eqx.Module in one.__mro__)
    if families and isinstance(value, families):
        yield from malformed(value, f"{name}.")
        return
    shapes = _shapes_in(options)
    if shapes:
        given = _given(value)
        if given.shape is None or not any(_fits(given.shape, shape) for shape in shapes):
            words = " or ".join(WORDS[shape] for shape in shapes)
            size = "" if given.shape is None else f", not of shape {given.shape}"
            remedy = EXAMPLES.get(shapes, IN_SI) if given.remedy == IN_SI else given.remedy
            if shapes == ((3,),) and isinstance(value, str) and value.lower().strip("+-") in _AXES:
                remedy = f"Write {_AXES[value.lower().strip('+-')]}."
            yield Requirement(name, value, False, f"be {words}{size}", remedy)
    elif families:
        yield Requirement(name, value, False, f"be a {_words_of(families[0])}", _remedy_for_part(value, families[0]))
    elif options == (str,) and not isinstance(value, str):
        yield Requirement(name, value, False, "be a name", 'Give a text, e.g. "ground", or "arm.tip" for a point.')
    elif options == (bool,) and not isinstance(value, bool | np.bool_):
        yield Requirement(name, value, False, "be True or False", "Give one of the two.")
    elif get_origin(annotation) is Mapping:
        yield from _entries(name, value, get_args(annotation)[1])
    elif get_origin(annotation) is tuple and get_args(annotation)[1:] == (...,) and isinstance(value, tuple | list):
        for i, one in enumerate(value):
            yield from of_form(f"{name}[{i}]", one, get_args(annotation)[0])


def _fits(shape: tuple[int, ...], allowed: tuple[int, ...]) -> bool:
    """Whether a shape is one that is allowed."""
    return len(shape) == len(allowed) and all(
        n == a or (a == -1 and n > 0) for n, a in zip(shape, allowed, strict=True)
    )


def is_numeric(value: Any) -> bool:
    """Whether a value is real numbers: a number, an array, lists of them in rows; not texts, truth values, times."""
    return shape_of(value) is not None


def shape_of(value: Any) -> tuple[int, ...] | None:
    """The shape of real numbers, traced ones in lists too; None for what is none."""
    return _given(value).shape


def visible(value: Any) -> Any:
    """The value, with NaN where an array of NumPy is masked; `np.asarray` would give the numbers behind the mask.

    NaN is what every function here takes for missing, or refuses.
    """
    return np.ma.filled(value.astype(np.float64), np.nan) if _is_masked(value) else value


def refuse_masked(value: Any) -> None:
    """Refuse masked arrays, and lists with masked entries.

    Raises:
        SceneError: naming the value.
    """
    if _is_masked(value) or (isinstance(value, list | tuple) and any(map(_is_masked, value))):
        raise SceneError(f"numbers were expected, not {value!r}. {_MASKED}")


def _is_masked(value: Any) -> bool:
    return isinstance(value, np.ma.MaskedArray) and bool(np.ma.is_masked(value))


_MASKED = "Some of its entries are masked; leave them out, or put numbers there, e.g. with np.ma.filled."


def whole_number(name: str, value: Any, remedy: str, least: int = 1) -> int:
    """A count that was asked for.

    Raises:
        SceneError: for what is no whole number, or below the least one.
    """
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer) or value < least:
        raise SceneError(f"{name} = {shown(value)} must be a whole number, at least {least}. {remedy}")
    return int(value)


def real_number(name: str, value: Any) -> None:
    """Refuse what is no single real number; traced ones pass.

    Raises:
        SceneError: naming the value.
    """
    for wrong in of_form(name, value, Shaped(((),))):
        raise SceneError(f"{name} = {shown(value)} must {wrong.expected}. {wrong.remedy}")


def two_names(name: str, value: Any, example: str) -> tuple[str, str]:
    """Two names, e.g. of bodies: of a text Python would take the first two letters, of three names the first two.

    Raises:
        SceneError: for anything else.
    """
    is_right = isinstance(value, tuple | list) and len(value) == 2 and all(isinstance(one, str) for one in value)
    if not is_right:
        raise SceneError(f"{name} = {shown(value)} must be two names. Write {name}={example}.")
    return value[0], value[1]


def mapping_of(name: str, value: Any, example: str) -> dict[str, Any]:
    """A dict by name.

    Raises:
        SceneError: for a list or anything else.
    """
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise SceneError(f"{name} = {shown(value)} must be a dict by name. Write {name}={example}.")
    return dict(value)


def _shapes_in(options: tuple) -> tuple[tuple[int, ...], ...]:
    """The shapes that an annotation allows; none where it says nothing of numbers."""
    found: tuple[tuple[int, ...], ...] = ()
    for option in options:
        if option is Scalar:
            found = (*found, ())
        elif option is Matrix3:
            found = (*found, (3, 3))
        elif isinstance(option, Shaped):
            found = (*found, *option.shapes)
        else:
            marks = getattr(option, "__metadata__", ())
            shaped = [mark.shapes for mark in marks if isinstance(mark, Shaped)]
            found = (*found, *(shaped[0] if shaped else _shapes_in(_options_of(get_args(option)[0])) if marks else ()))
    return found


def _options_of(annotation: Any) -> tuple:
    """What an annotation leaves the choice of."""
    return get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)


def _given(value: Any) -> _Given:
    """Shape of real numbers, or why a value is none."""
    if type(value) is float:  # most are, of which nothing has to be asked
        return _Given((), IN_SI)
    if _is_masked(value):
        return _Given(None, _MASKED)
    if isinstance(value, jax.core.Tracer | jax.Array | np.ndarray | np.generic):
        return _of_kind(value.dtype.kind if value.dtype.kind != "V" else "f", tuple(value.shape))
    if isinstance(value, bool):
        return _of_kind("b", ())
    if isinstance(value, Real | Decimal):
        try:
            float(value)
        except OverflowError:
            return _Given(None, "It is larger than any number of 64 bits, 1.8e308.")
        return _Given((), IN_SI)
    if isinstance(value, str | bytes):
        return _of_kind("U", ())
    if isinstance(value, Sequence):
        inner = [_given(entry) for entry in value]
        wrong = next((one for one in inner if one.shape is None), None)
        if wrong is not None:
            return wrong
        if len({one.shape for one in inner}) > 1:
            return _Given(None, "Its rows have different lengths.")
        return _Given((len(value), *(inner[0].shape or () if inner else ())), IN_SI)
    if isinstance(value, datetime.timedelta | datetime.datetime):
        return _of_kind("m", ())
    if isinstance(value, complex):
        return _of_kind("c", ())
    if hasattr(value, "magnitude") or (hasattr(value, "unit") and hasattr(value, "to")):
        return _Given(None, "It has a unit of its own; convert it to SI units, and give the plain number.")
    if hasattr(value, "__array__"):
        return _given(np.asarray(value))
    return _Given(None, IN_SI)


def _of_kind(kind: str, shape: tuple[int, ...]) -> _Given:
    remedies = {
        "b": "A truth value is no number.",
        "c": "Complex numbers mean nothing here; give the real part.",
        "m": "A time is no number; give seconds, e.g. x / np.timedelta64(1, 's').",
        "M": "A date is no number; give seconds since the start.",
        "U": "Texts with units belong in scene files; give the plain number in SI units, without quotes.",
        "S": "Texts with units belong in scene files; give the plain number in SI units, without quotes.",
    }
    return _Given(None if kind in remedies or kind not in "fiu" else shape, remedies.get(kind, IN_SI))


def _entries(name: str, value: Any, annotation: Any) -> Iterator[Requirement]:
    if not isinstance(value, Mapping):
        yield Requirement(name, value, False, "be a dict by name", f'Write {name}={{"tip": (0.0, 0.0, 0.1)}}.')
        return
    for key, entry in value.items():
        yield from of_form(f"{name}[{key!r}]", entry, annotation)


def _words_of(family: type) -> str:
    """What members of a family are called, e.g. `"normal law"`."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", family.__name__.removeprefix("Abstract")).lower()


def _members(family: type) -> list[str]:
    """Names of what can be made of a family, as the package has it."""
    if not inspect.isabstract(family):
        return [family.__name__]
    own = (one for one in family.__subclasses__() if one.__module__.partition(".")[0] == __name__.partition(".")[0])
    return list(dict.fromkeys(name for one in own for name in _members(one)))


def _remedy_for_part(value: Any, family: type) -> str:
    if inspect.isclass(value) and issubclass(value, family):
        return f"The class alone was given; make an object of it, with parentheses: {value.__name__}(...)."
    return f"Give an object: {', '.join(f'{name}(...)' for name in _members(family))}, or one of your own."
