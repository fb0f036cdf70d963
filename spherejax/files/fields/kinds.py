"""Kinds: which class a word like "lankarani-nikravesh" names, and which word names a class.

A kind is the class name in kebab-case. Classes of a user are named by where they are: "my_laws.py:MyForce", with a path
in the scene file's folder, see `code`.
"""

import inspect
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, get_args, get_origin

from spherejax.files.fields.code import named_by, users_own
from spherejax.files.fields.dimensions import FIELDS, Fields, described_field, parameters_of
from spherejax.files.fields.fields import Context, Plain, words_of
from spherejax.files.fields.location import FilePlace
from spherejax.files.fields.parts import OwnFunction, PartField
from spherejax.files.fields.quantities import QuantityField
from spherejax.foundations.errors import SceneError, one_of
from spherejax.foundations.parts import kebab
from spherejax.model.drift import AbstractDriftControl
from spherejax.physics.forces.base import AbstractForce
from spherejax.physics.functions.base import AbstractFunction
from spherejax.physics.joints.joint import AbstractJoint


def kinds_of(family: type) -> dict[str, type]:
    """The classes of a family by kind, as the package has them."""
    members = (cls for cls in FIELDS if issubclass(cls, family))
    return {kebab(cls.__name__): cls for cls in members}


def class_named(kind: str, family: type, context: Context, place: FilePlace) -> Any:
    """The class of a kind, or a user's function; `place.fail` where there is none."""
    if ":" in kind:
        return users_own(kind, family, context, place)
    plain = {_letters(name): cls for name, cls in kinds_of(family).items()}
    if _letters(kind) in plain:
        return plain[_letters(kind)]
    elsewhere = [cls for cls in FIELDS if _letters(cls.__name__) == _letters(kind)]
    known = one_of(sorted(kinds_of(family)), kind)
    what = words_of(family)
    if elsewhere:
        place.fail(f"{kind!r} is no {what}; {known}")
    place.fail(f'unknown kind {kind!r} of {what}; {known}; or a class of your own, "my_file.py:MyClass"')


def kind_of(cls: Any, folder: Path) -> str:
    """The kind that names a class, or a user's function, in a file of this folder.

    Raises:
        SceneError: for one that no file can name.
    """
    if cls in FIELDS:
        return kebab(cls.__name__)
    what = "class" if inspect.isclass(cls) else "Python function"
    remedy = f"put the {what} at the top of a file of its own, and import it from there"
    name, module = getattr(cls, "__qualname__", repr(cls)), sys.modules.get(getattr(cls, "__module__", ""))
    if module is None or cls.__module__ == "__main__" or getattr(module, name, None) is not cls:
        raise SceneError(f"the {what} {name} cannot be named in a file; {remedy}")
    return named_by(cls, module, folder, what)


def fields_of(cls: type) -> Fields:
    """What the arguments of a class hold, as their annotations say; a user's numbers without a unit are in any."""
    if cls in FIELDS:
        return FIELDS[cls]
    try:
        told = inspect.signature(cls, eval_str=True).parameters
    except (NameError, SyntaxError):  # annotations that are texts, of names that are there for type checkers only
        told = parameters_of(cls)
    return {name: _field_of(told[name]) for name in parameters_of(cls)}


def keys_of(cls: type) -> list[tuple[str, str, str]]:
    """The keys of a class in a file, those that must be given with a star, what they hold, and what they are."""
    needed = {name for name, parameter in parameters_of(cls).items() if is_needed(parameter)}
    defaults = {name: p.default for name, p in parameters_of(cls).items() if type(p.default) in (int, float, bool, str)}
    told = attributes_told(cls)
    return [
        (
            f"{name} *" if name in needed else name,
            field.what + (f", {_plain(defaults[name])} by default" if name in defaults else ""),
            told.get(name, ""),
        )
        for name, field in fields_of(cls).items()
    ]


def attributes_told(cls: type) -> dict[str, str]:
    """What the docstring of a class, or of one that it is derived from, says of its attributes, without the unit."""
    found: dict[str, str] = {}
    for one in reversed(cls.__mro__):
        section = re.split(r"\n\s*(?:Args|Attributes):\n", inspect.cleandoc(one.__doc__ or ""), maxsplit=1)[1:]
        for entry in _ENTRY.finditer(section[0] if section else ""):
            text = " ".join(entry["text"].replace("`", "").split())
            words = re.split(r"[;.:](?:\s|$)| \[|, shape ", text, maxsplit=1)[0].rstrip(",")
            found |= dict.fromkeys(entry["names"].split(", "), words)
    return found


_ENTRY = re.compile(r"^    (?P<names>\w+(?:, \w+)*): (?P<text>.*(?:\n {5,}\S.*)*)", re.MULTILINE)
"""Names and what is said of them, in as many lines as it takes."""


def _plain(value: Any) -> str:
    """A default as it is written in a file."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def family_names() -> list[tuple[str, type]]:
    """The families whose members stand in files, by the key that holds them."""
    found: dict[type, str] = {}
    for cls, fields in FIELDS.items():
        for name, field in fields.items():
            if isinstance(field, PartField) and field.family not in found and field.family is not OwnFunction:
                found[field.family] = f"{words_of(field.family)}: {name} = {{ kind = ... }} of {kebab(cls.__name__)}"
    top: list[tuple[str, type]] = [
        ("[joints.NAME]", AbstractJoint), ("[forces.NAME]", AbstractForce), ("drift", AbstractDriftControl),
    ]  # fmt: skip
    return [*top, *((title, family) for family, title in found.items())]


def is_needed(parameter: inspect.Parameter) -> bool:
    """Whether an argument must be given."""
    return parameter.default is inspect.Parameter.empty and parameter.kind is not inspect.Parameter.VAR_POSITIONAL


def _field_of(parameter: inspect.Parameter):
    if hasattr(parameter.annotation, "__metadata__"):
        return described_field(parameter) or QuantityField(None, None)
    annotation = _class_in(parameter.annotation)
    if annotation in (bool, str, int):
        return Plain(annotation)
    if (get_origin(annotation) or annotation) is Callable:
        return PartField(AbstractFunction)
    if isinstance(annotation, type) and annotation in _families():
        return PartField(annotation)
    return QuantityField(None, None)


def _class_in(annotation: Any) -> Any:
    """The class in `X | None`; a text is looked up among the plain kinds."""
    if isinstance(annotation, str):
        words = {"bool": bool, "str": str, "int": int, **{family.__name__: family for family in _families()}}
        return words.get(annotation.removesuffix(" | None").rpartition(".")[2])
    options = [option for option in get_args(annotation) if option is not type(None)]
    return options[0] if len(options) == 1 else annotation


@cache
def _families() -> frozenset[type]:
    """The classes of the table and what they are derived from."""
    return frozenset(
        base for cls in FIELDS for base in cls.__mro__ if base.__module__.startswith(__name__.partition(".")[0] + ".")
    )


def _letters(kind: str) -> str:
    """Kinds are compared without hyphens and case: "lugre", "lu-gre" and "LuGre" are one."""
    return re.sub(r"[-_ ]", "", kind).lower()
