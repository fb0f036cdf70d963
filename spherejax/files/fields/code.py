"""Code of users in scene files: `kind = "my_laws.py:MyForce"`.

A scene file is data: it can be read without a second thought, whoever wrote it. Naming a class is the one thing in it
that runs Python, so it is done only where the caller allows it, `allow_code=True` or `--allow-code`, and only with
files in the scene file's own folder: what is allowed lies beside the file and can be read there. The text is compiled
anew, no compiled file is taken for it. Of modules that are installed, only those serve that the program has imported
itself: a file imports none.
"""

import inspect
import sys
import traceback
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath, PureWindowsPath
from types import ModuleType
from typing import Any
from zlib import crc32

from spherejax.files.fields.fields import Context, words_of
from spherejax.files.fields.location import FilePlace
from spherejax.files.fields.parts import OwnFunction
from spherejax.foundations.errors import SceneError, one_of
from spherejax.physics.functions.base import AbstractFunction

TAKE_CALLABLES = (AbstractFunction, OwnFunction)
"""Families for which any function, or class whose objects can be called, will do."""

_PREFIX = "scene_file_"
"""Of the names of modules that are made from files beside scene files."""


def users_own(kind: str, family: type, context: Context, place: FilePlace) -> Any:
    """The class or function that `"my_file.py:MyClass"` names; `place.fail` where it is not allowed or not there."""
    where, _, name = kind.rpartition(":")
    if not context.allow_code:
        place.fail(
            f"{kind!r} would run Python code, and reading a file runs none unless it is allowed. If you trust "
            f"{where!r}, allow it: sj.load_scene(path, allow_code=True), or --allow-code on the command line"
        )
    if where.endswith(".py"):
        path = _path_in(context.folder, where, kind, place)
        with reported(place, f"{kind!r} cannot be imported"):
            module = _module_at(path)
    else:
        module = _imported(where, name, kind, place)
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


def named_by(cls: Any, module: ModuleType, folder: Path, what: str) -> str:
    """The text that names a user's class, or function, in a scene file of a folder.

    Raises:
        SceneError: for one that such a file could not name when it is read.
    """
    path = getattr(module, "__file__", None)
    if path is not None and Path(path).suffix == ".py" and "." not in cls.__module__:
        path, root = Path(path).resolve(), folder.resolve()
        if path.is_relative_to(root):
            return f"{path.relative_to(root).as_posix()}:{cls.__name__}"
    if cls.__module__.startswith(_PREFIX):
        raise SceneError(
            f"the {what} {cls.__name__} comes from {str(path)!r}, which is not in the folder {str(folder)!r}, "
            "and a scene file takes code from its own folder only; copy it there, and read the scene with that copy"
        )
    if path is None:
        raise SceneError(f"the {what} {cls.__name__} comes from no file; put it into a file of its own")
    return f"{cls.__module__}:{cls.__name__}"


@contextmanager
def reported(place: FilePlace, what: str) -> Iterator[None]:
    """Whatever a user's code raises, `SystemExit` included, as an error at a place, with its own file and line."""
    try:
        yield
    except (SceneError, KeyboardInterrupt):
        raise
    except BaseException as error:
        place.fail(f"{what}: {described_error(error)}")


def described_error(error: BaseException) -> str:
    """Kind and words of an error, behind the file and line of a user's code that raised it, where it is one."""
    if isinstance(error.__cause__, SystemExit):  # as `cached_jit` reports it
        error = error.__cause__
    said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    at = line_of(error)
    return said if at is None else f"{at}: {said}"


def line_of(error: BaseException) -> str | None:
    """`"my_laws.py:12"`: the innermost line of code from beside a scene file that an error went through."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    frames = [
        f"{frame.f_code.co_filename}:{line}"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__", "")).startswith(_PREFIX)
    ]
    return frames[-1] if frames else None


def modules_in(pickled: bytes) -> dict[str, str]:
    """The files beside scene files whose classes stand in a pickle, by the names of their modules."""
    named = {name: module for name, module in list(sys.modules.items()) if name.startswith(_PREFIX)}
    return {name: str(module.__file__) for name, module in named.items() if name.encode() in pickled}


def run_again(files: Mapping[str, str]) -> None:
    """Run in a worker process what the process that sent the work was allowed to run, and has run.

    Raises:
        SceneError: for a file that is not there, or has changed since.
    """
    for name, file in files.items():
        path = Path(file)
        if name in sys.modules:
            continue
        if not path.is_file() or _name_of(path, path.read_bytes()) != name:
            raise SceneError(f"{file!r} is not here as it was where the work was sent from; share the file, unchanged")
        _run(path, path.read_bytes())


def _path_in(folder: Path, where: str, kind: str, place: FilePlace) -> Path:
    """The file, which must be in the folder, also when links are followed."""
    for flavor in (PurePosixPath, PureWindowsPath):
        given = flavor(where)
        if given.is_absolute() or given.anchor or ".." in given.parts:
            place.fail(
                f"{kind!r}: code is taken from the scene file's own folder only; move the file there, and name it by "
                f'its path in it, e.g. "{given.name}:{kind.rpartition(":")[2]}"'
            )
    try:
        root = folder.resolve()
        path = (root / where).resolve()
        is_file = path.is_file()
    except (OSError, ValueError) as error:
        place.fail(f"{kind!r} is no path of a file: {error}")
    if not path.is_relative_to(root):
        place.fail(
            f"{kind!r} is a link that leads out of the scene file's folder, to {str(path)!r}, and code is taken from "
            "that folder only; copy the file there"
        )
    if not is_file:
        place.fail(f"{kind!r}: there is no file {str(folder / where)!r}; the path counts from the scene file's folder")
    return path


def _imported(where: str, name: str, kind: str, place: FilePlace) -> ModuleType:
    """A module that the program has imported itself."""
    module = sys.modules.get(where)
    if where.partition(".")[0] in sys.stdlib_module_names:
        place.fail(f"{kind!r}: Python's own modules have no parts of a mechanism; name a class or function of yours")
    if module is None:
        place.fail(
            f"{kind!r}: no module {where!r} is imported, and a scene file imports none. Import it before the file is "
            f'read; or, beside the file, write a my_laws.py with "from {where} import {name}", and '
            f'kind = "my_laws.py:{name}"'
        )
    return module


def _serves_as(found: Any, family: type) -> bool:
    """Whether something in a user's file is a member of a family."""
    if not inspect.isclass(found):
        return inspect.isfunction(found) and family in TAKE_CALLABLES
    has_call = any("__call__" in vars(base) for base in found.__mro__)
    return issubclass(found, family) or (family in TAKE_CALLABLES and has_call)


def _module_at(path: Path) -> ModuleType:
    """The module of a file: the one that is imported already, so that its classes are the same, or a new one."""
    for name, module in list(sys.modules.items()):
        file = getattr(module, "__file__", None)
        if not isinstance(file, str) or not file.endswith(path.name) or name == "__main__" or name.startswith(_PREFIX):
            continue
        if Path(file).resolve() == path:
            return module
    source = path.read_bytes()
    return sys.modules.get(_name_of(path, source)) or _run(path, source)


def _name_of(path: Path, source: bytes) -> str:
    """By path and text: a file that was edited is another module."""
    return f"{_PREFIX}{path.stem}_{crc32(str(path).encode()):08x}_{crc32(source):08x}"


def _run(path: Path, source: bytes) -> ModuleType:
    module = ModuleType(_name_of(path, source))
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    try:
        exec(compile(source, str(path), "exec"), vars(module))
    except BaseException:
        del sys.modules[module.__name__]
        raise
    return module
