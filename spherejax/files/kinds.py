"""Kinds: which class a word like "lankarani-nikravesh" names, and which word names a class.

A kind is the class name in kebab-case. Classes of a user are named by where they are: "my_laws.py:MyForce", with a path
relative to the scene file, or "package.module:MyForce".
"""

import importlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, get_args, get_origin
from zlib import crc32

from spherejax.files.dimensions import FIELDS, Fields
from spherejax.files.fields import Plain, words_of
from spherejax.files.parts import OwnFunction, Part
from spherejax.files.place import Place, one_of
from spherejax.files.quantities import Quantity
from spherejax.foundations.checks import SceneError
from spherejax.model.drift import AbstractDriftControl
from spherejax.physics.forces import AbstractForce
from spherejax.physics.functions import AbstractFunction
from spherejax.physics.joints import AbstractJoint

SPELLINGS = {"BrownMcPhee": "brown-mcphee", "LuGre": "lugre"}
"""Names with capitals inside that begin no word."""


def kebab(name: str) -> str:
    """`"LankaraniNikravesh"` as `"lankarani-nikravesh"`."""
    return SPELLINGS.get(name) or re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()


def kinds_of(family: type) -> dict[str, type]:
    """The classes of a family by kind, as the package has them."""
    members = (cls for cls in FIELDS if issubclass(cls, family))
    return {kebab(cls.__name__): cls for cls in members}


def class_named(kind: str, family: type, folder: Path, place: Place) -> Any:
    """The class of a kind, or a user's function; `place.fail` where there is none."""
    if ":" in kind:
        return _users_own(kind, family, folder, place)
    plain = {_letters(name): cls for name, cls in kinds_of(family).items()}
    if _letters(kind) in plain:
        return plain[_letters(kind)]
    elsewhere = [cls for cls in FIELDS if _letters(cls.__name__) == _letters(kind)]
    known = one_of(kinds_of(family), kind)
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
    if "." in cls.__module__:
        return f"{cls.__module__}:{cls.__name__}"
    if getattr(module, "__file__", None) is None:
        raise SceneError(f"the {what} {name} comes from no file; {remedy}")
    return f"{Path(os.path.relpath(str(module.__file__), folder)).as_posix()}:{cls.__name__}"


def fields_of(cls: type) -> Fields:
    """What the arguments of a class hold; of a user's class by its annotations, and its `units`.

    A user's class says what its numbers are by a class variable, `units: ClassVar = {"stiffness": "N/m"}`; numbers
    without an entry are taken in any unit.
    """
    if cls in FIELDS:
        return FIELDS[cls]
    units: Mapping[str, str] = getattr(cls, "units", {})
    return {
        name: _field_of(_class_in(parameter.annotation), units.get(name))
        for name, parameter in parameters_of(cls).items()
    }


def parameters_of(cls: type) -> dict[str, inspect.Parameter]:
    """The arguments of a class's constructor."""
    return {
        name: parameter
        for name, parameter in inspect.signature(cls).parameters.items()
        if parameter.kind is not inspect.Parameter.VAR_KEYWORD
    }


def keys_of(cls: type) -> list[tuple[str, str]]:
    """The keys of a class in a file, those that must be given with a star, and what they hold."""
    needed = {name for name, parameter in parameters_of(cls).items() if is_needed(parameter)}
    defaults = {name: p.default for name, p in parameters_of(cls).items() if type(p.default) in (int, float, bool, str)}
    return [
        (
            f"{name} *" if name in needed else name,
            field.what + (f", {_plain(defaults[name])} by default" if name in defaults else ""),
        )
        for name, field in fields_of(cls).items()
    ]


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
            if isinstance(field, Part) and field.family not in found and field.family is not OwnFunction:
                found[field.family] = f"{words_of(field.family)}: {name} = {{ kind = ... }} of {kebab(cls.__name__)}"
    top: list[tuple[str, type]] = [
        ("[joints.NAME]", AbstractJoint), ("[forces.NAME]", AbstractForce), ("drift", AbstractDriftControl),
    ]  # fmt: skip
    return [*top, *((title, family) for family, title in found.items())]


def is_needed(parameter: inspect.Parameter) -> bool:
    """Whether an argument must be given."""
    return parameter.default is inspect.Parameter.empty and parameter.kind is not inspect.Parameter.VAR_POSITIONAL


def _field_of(annotation: Any, unit: str | None):
    if annotation in (bool, str, int):
        return Plain(annotation)
    if (get_origin(annotation) or annotation) is Callable:
        return Part(AbstractFunction)
    if isinstance(annotation, type) and annotation in _families():
        return Part(annotation)
    return Quantity(unit, None)


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


def _users_own(kind: str, family: type, folder: Path, place: Place) -> Any:
    where, _, name = kind.rpartition(":")
    try:
        module = _module_at((folder / where).resolve()) if where.endswith(".py") else importlib.import_module(where)
    except FileNotFoundError:
        place.fail(f"{kind!r}: there is no file {str(folder / where)!r}; the path counts from the scene file's folder")
    except Exception as error:  # whatever the user's code raises
        place.fail(f"{kind!r} cannot be imported: {type(error).__name__}: {error}")
    found = getattr(module, name, None)
    if not (inspect.isclass(found) or inspect.isfunction(found)):
        offered = [key for key, value in vars(module).items() if _serves_as(value, family)]
        what = "function or class" if family in TAKE_CALLABLES else "class"
        place.fail(f"{where} has no {what} {name!r}; {one_of(offered, name)}")
    if not _serves_as(found, family):
        remedy = "give a function" if family in TAKE_CALLABLES else f"derive a class from {family.__name__}"
        place.fail(f"{kind!r} is no {words_of(family)}; {remedy}")
    if inspect.isabstract(found):
        lacking = sorted(getattr(found, "__abstractmethods__", ()))
        place.fail(f"{kind!r} is abstract; it lacks {', '.join(lacking)}")
    return found


TAKE_CALLABLES = (AbstractFunction, OwnFunction)
"""Families for which any function, or class whose objects can be called, will do."""


def _serves_as(found: Any, family: type) -> bool:
    """Whether something in a user's file is a member of a family."""
    if not inspect.isclass(found):
        return inspect.isfunction(found) and family in TAKE_CALLABLES
    has_call = any("__call__" in vars(base) for base in found.__mro__)
    return issubclass(found, family) or (family in TAKE_CALLABLES and has_call)


def _module_at(path: Path) -> ModuleType:
    """The module of a file: the one that is imported already, so that its classes are the same, or a new one."""
    for module in list(sys.modules.values()):
        file = getattr(module, "__file__", None)
        if file is None or not file.endswith(path.name) or module.__name__ == "__main__":
            continue
        if Path(file).resolve() == path:
            return module
    if not path.is_file():
        raise FileNotFoundError(path)
    name = f"scene_file_{path.stem}_{crc32(str(path).encode()):08x}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
