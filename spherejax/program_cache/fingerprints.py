"""Fingerprints of what code computes: of traced programs, and of Python values that cannot be traced.

A traced program is told by its operations and constants, not by how it was written: renaming, comments and moving code
about leave its fingerprint as it is, and a changed number anywhere, in helpers too, does not. Python functions that are
not traced (a force in a scene, a callback on the host) are told by their bytecode, defaults, closures, and what
they use of their modules. Addresses and the order of sets are left out, so that another process finds the same.
"""

import dataclasses
import dis
import enum
import functools
import hashlib
import os
import re
import site
import sys
import sysconfig
import types
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jex

from spherejax.program_cache import settings

NOT_COMPUTED = frozenset({
    "name", "debug_info", "ctx_mesh",
    "jvp_jaxpr_fun", "fwd_jaxpr_thunk", "fwd", "bwd", "out_trees", "call", "jvp", "transpose_rule",
})  # fmt: skip
"""Parameters of operations that say nothing about the value: names, and rules of derivatives, which are functions that
JAX makes anew in each trace. Where derivatives are wanted, trace them."""


class Traced(NamedTuple):
    """What a function computes.

    Attributes:
        fingerprint: the same for functions that compute the same.
        is_bound: whether equal code may stand for different objects: it calls Python when it runs
            (`jax.pure_callback`), or closes over a traced value.
    """

    fingerprint: str
    is_bound: bool


def program_fingerprint(function: Callable, *examples: Any) -> Traced:
    """What a function computes from arrays.

    Args:
        function: pure JAX code.
        *examples: arrays or `jax.ShapeDtypeStruct`s, in any pytrees; only shapes and types matter.
    """
    # A function of its own each time: JAX would remember an earlier trace, and what a module held then.
    closed, shapes = jax.make_jaxpr(lambda *given: function(*given), return_shape=True)(*examples)
    words = _Words()
    words.program(closed.jaxpr, closed.consts)
    words.value([(each.shape, str(each.dtype)) for each in jax.tree.leaves(shapes)])
    fingerprint = words.fingerprint  # to the end, before anything else is known
    return Traced(fingerprint, words.is_bound)


def value_fingerprint(value: Any) -> str:
    """What a Python value is: numbers, containers, objects by their fields, functions and classes by their code."""
    words = _Words()
    words.value(value)
    return words.fingerprint


def known_fingerprint(value: Any) -> str | None:
    """The fingerprint of what versions of packages tell (those of the settings); None for all else.

    What is a user's is not looked into any further: it may be large, and may be anything.
    """
    words = _Words(is_known_only=True)
    try:
        words.value(value)
        fingerprint = words.fingerprint
    except (_ForeignError, RecursionError):  # the latter in a text that an object makes of itself
        return None
    return None if words.is_bound else fingerprint


def own_parts(value: Any) -> tuple:
    """Classes, functions and objects in a value that no version tells: code of a user's own, not looked into."""
    words = _Words(is_collecting=True)
    words.value(value)
    words.finish()
    return tuple(words.foreign.values())


def code_fingerprint(parts: tuple, *, with_state: bool = True) -> str:
    """What code of a user's own is now, with what it looks up, but for names that it assigns to itself.

    Args:
        parts: classes, functions and objects, as `own_parts` finds them.
        with_state: with lists, arrays and objects that it looks up; else with functions, classes and numbers alone.
    """
    words = _Words(is_of_code=True, with_state=with_state)
    words.value(parts)
    return words.fingerprint


def reaches_tracer(parts: tuple) -> bool:
    """Whether code of a user's own looks up a value that JAX traces, in its closures, globals, classes or objects.

    Args:
        parts: classes, functions and objects, as `own_parts` finds them.
    """
    words = _Words(is_of_code=True)
    with suppress(Exception):  # what code looks up may be anything, and fail when it is looked at
        words.value(parts)
        words.finish()
    return words.is_traced


class _ForeignError(Exception):
    """Something that no version tells."""


def combined(*fingerprints: str) -> str:
    """One fingerprint of several."""
    return _digest("\0".join(fingerprints).encode())


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


MOST = 10_000
"""Functions and classes of a user's own that are looked into for one fingerprint: a package of some size has fewer.

Beyond that, what is looked into is no code of a user's own but a library that nobody has installed."""


class _Words:
    """Words that are hashed one after the other.

    An object within another one is hashed as a number, and looked into when the one around it is finished. So the depth
    of calls is that of one object's own parts, however deep objects lie in each other, and however long a chain of
    functions is that look each other up.
    """

    def __init__(
        self,
        is_known_only: bool = False,
        *,
        is_collecting: bool = False,
        is_of_code: bool = False,
        with_state: bool = True,
    ):
        self._hash = hashlib.sha256()
        self._is_known_only = is_known_only
        self._is_collecting, self._is_of_code, self._with_state = is_collecting, is_of_code, with_state
        self.is_bound = False
        self.is_traced = False  # whether a tracer was met
        self.foreign: dict[int, Any] = {}  # what no version tells, where that is collected
        self._met: dict[int, tuple[int, Any]] = {}  # objects are kept: an address is not given out twice
        self._waiting: deque[Any] = deque()
        self._n_looked_into = 0
        self._around: frozenset[int] = frozenset()  # sets in which this is a part

    @property
    def fingerprint(self) -> str:
        self.finish()
        return self._hash.hexdigest()[:32]

    def finish(self) -> None:
        """Look into all objects that were met."""
        while self._waiting:
            self._composed(self._waiting.popleft())

    def _meets(self, is_foreign: bool, value: Any) -> bool:
        """Note what no version tells; whether it is not to be looked into."""
        if is_foreign and self._is_known_only:
            raise _ForeignError
        if is_foreign and self._is_collecting:
            self.foreign[id(value)] = value
        return is_foreign and self._is_collecting

    def word(self, *words: object) -> None:
        for each in words:
            text = str(each).encode()
            self._hash.update(len(text).to_bytes(8, "big") + text)

    # Programs -------------------------------------------------------------------------------------------------------

    def program(self, jaxpr: Any, constants: Any) -> None:
        number: dict[Any, int] = {}

        def read(atom: Any) -> None:
            if isinstance(atom, jex.Literal):
                self.word("literal", atom.aval)
                self.array(atom.val)
            else:
                self.word(number[atom])

        for variable in (*jaxpr.constvars, *jaxpr.invars):
            self.word(number.setdefault(variable, len(number)), variable.aval)
        for constant in constants:
            self.array(constant)
        for equation in jaxpr.eqns:
            self.word("equation", equation.primitive.name)
            self.is_bound |= "callback" in equation.primitive.name
            for atom in equation.invars:
                read(atom)
            for key in sorted(set(equation.params) - NOT_COMPUTED):
                self.word(key)
                self.value(equation.params[key])
            for variable in equation.outvars:
                self.word(number.setdefault(variable, len(number)), variable.aval)
        for atom in jaxpr.outvars:
            read(atom)

    def array(self, value: Any) -> None:
        if isinstance(value, jax.core.Tracer):
            # A constant of a trace around this one: what it holds is not known, what it is, is.
            self.is_bound = self.is_traced = True
            self.word("traced", value.aval)
            return
        if hasattr(value, "dtype") and jnp.issubdtype(value.dtype, jax.dtypes.extended):
            value = jax.random.key_data(value)
        array = np.asarray(value)
        self.word("array", array.dtype, array.shape)
        self._hash.update(np.ascontiguousarray(array).tobytes())

    # Values ---------------------------------------------------------------------------------------------------------

    def value(self, value: Any) -> None:
        if value is None or isinstance(value, bool | int | float | complex | str | bytes | np.dtype):
            self.word(type(value).__name__, repr(value))
        elif isinstance(value, jex.ClosedJaxpr):
            self.program(value.jaxpr, value.consts)
        elif isinstance(value, jex.Jaxpr):
            self.program(value, ())
        elif isinstance(value, jax.ShapeDtypeStruct):
            self.word("shape", value.shape, value.dtype)
        elif isinstance(value, jax.Array) or (isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject):
            self.array(value)
        elif isinstance(value, enum.Enum):
            self.word(_name_of(type(value)), value.name)
        elif isinstance(value, types.ModuleType):
            self.word("module", value.__name__)
        else:
            if id(value) not in self._met:
                self._met[id(value)] = (len(self._met), value)
                self._waiting.append(value)
            self.word("met", self._met[id(value)][0])

    def _composed(self, value: Any) -> None:
        if isinstance(value, Mapping):
            self.word(type(value).__name__, len(value))
            for key in sorted(value, key=repr):
                self.value(key)
                self.value(value[key])
        elif isinstance(value, set | frozenset):
            around = self._around | {id(value)}
            self.word(type(value).__name__, *sorted(self._alone(each, around) for each in value))
        elif isinstance(value, tuple | list | np.ndarray):
            self.word(type(value).__name__, len(value))
            for each in value:
                self.value(each)
        elif isinstance(value, functools.partial):
            self.value(("partial", value.func, value.args, value.keywords))
        elif isinstance(value, types.MethodType):
            self.value(("method", value.__func__, value.__self__))
        elif isinstance(value, type):
            self._class(value)
        elif isinstance(value, types.FunctionType):
            self._function(value)
        elif isinstance(value, property | staticmethod | classmethod | functools.cached_property):
            self.value([getattr(value, name, None) for name in ("fget", "__func__", "func")])
        elif isinstance(value, jax.tree_util.PyTreeDef):
            self._tree(value)
        elif _is_of_jax(value) and not dataclasses.is_dataclass(value):
            self._text(value)
        else:
            self._object(value)

    def _alone(self, value: Any, around: frozenset[int]) -> str:
        """The fingerprint of a part of a set, whatever came before it."""
        words = _Words(
            self._is_known_only,
            is_collecting=self._is_collecting,
            is_of_code=self._is_of_code,
            with_state=self._with_state,
        )
        words.foreign, words._n_looked_into = self.foreign, self._n_looked_into
        # A function in a set may look up that set.
        words._around, words._met = around, {each: (-1, None) for each in around}
        words.value(value)
        fingerprint = words.fingerprint
        self.is_bound |= words.is_bound
        self._n_looked_into = words._n_looked_into
        self.is_traced |= words.is_traced
        return fingerprint

    def _object(self, value: Any) -> None:
        if hasattr(type(value), "__cache_key__"):  # it knows better than its fields
            self.value((type(value).__name__, value.__cache_key__()))
            return
        wrapped = getattr(value, "__wrapped__", None)
        if callable(wrapped):  # jax.jit, functools.lru_cache and their like
            self.value(("wrapped", type(value).__name__, wrapped))
            return
        self.value(type(value))
        if self._is_of_code and not dataclasses.is_dataclass(value) and is_installed(type(value).__module__, None):
            return  # a logger, a file, a table of another library: it would be looked into without end
        if dataclasses.is_dataclass(value):
            fields = {field.name: getattr(value, field.name, None) for field in dataclasses.fields(value)}
        else:
            slots = [name for kind in type(value).__mro__ for name in _as_list(getattr(kind, "__slots__", ()))]
            fields = {**{name: getattr(value, name, None) for name in slots}, **getattr(value, "__dict__", {})}
        if fields:
            self.value(fields)
        else:
            self._text(value)

    def _tree(self, tree: Any) -> None:
        """By what it is the structure of: its text would not tell one function in it from another."""
        try:
            example = jax.tree.unflatten(tree, range(tree.num_leaves))
        except Exception:  # a class of a user's own that does not take numbers for its leaves
            if not self._meets(True, tree):
                self._text(tree)
            return
        self.value(("tree", tree.num_leaves, example))

    def _text(self, value: Any) -> None:
        text = repr(value)
        without = _without_addresses(text)
        self._meets(without != text, value)
        self.word(without)

    def _class(self, kind: type) -> None:
        self.word("class", _name_of(kind))
        if self._meets(not _is_versioned(kind.__module__), kind) or self._is_told(kind.__module__, None):
            return
        self._look_into()
        self.value([base for base in kind.__bases__ if base is not object])
        own = {name: each for name, each in vars(kind).items() if not name.startswith("__") or name == "__call__"}
        own = {name: each for name, each in own.items() if not name.startswith("_abc")}
        if not self._is_of_code:
            self.value(own)
            return
        for name in sorted(own):
            self.word(name)
            self._used(own[name])

    def _function(self, function: types.FunctionType) -> None:
        if self._meets(not _is_versioned(function.__module__), function):
            return
        if self._is_told(function.__module__, function.__code__.co_filename):
            self.word("function", _name_of(function))
            if _top(function.__module__) == settings.current().package:
                self._closed_over(function)
            return
        self._look_into()
        self._code(function.__code__, function.__doc__)
        self._closed_over(function)
        assigned = _assigned_in(function.__code__) if self._is_of_code else frozenset()
        for name, used in _used_of_modules(function) if self._is_of_code else ():
            self.word(name)
            self._used(used)
        for name, used in _used_globals(function):
            self.word(name)
            if name not in assigned:
                self._used(used)

    def _is_told(self, module: str | None, file: str | None) -> bool:
        """Whether code is told by its name: that of Python, and of packages.

        Raises:
            _ForeignError: for a versioned package that is not installed, such as a checkout of JAX, where versions
                shall tell: its version does not. Within a process it stays what it is.
        """
        if is_installed(module, file):
            return True
        if not (_is_versioned(module) and _is_in_package(module, file)):
            return False
        if self._is_known_only:
            raise _ForeignError
        return True

    def _look_into(self) -> None:
        self._n_looked_into += 1
        if self._n_looked_into > MOST:
            raise RuntimeError(f"more than {MOST:,} functions and classes are looked up")

    def _closed_over(self, function: types.FunctionType) -> None:
        self.value([function.__defaults__, function.__kwdefaults__])
        assigned = _assigned_in(function.__code__) if self._is_of_code else frozenset()
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            try:
                if name not in assigned:
                    self._used(cell.cell_contents)
            except ValueError:  # a cell that has not been filled yet
                self.word("empty")

    def _used(self, value: Any) -> None:
        """Something that code looks up."""
        if self._with_state or isinstance(value, (*_STATELESS, jax.Array)):
            self.value(value)
        else:
            self.word("state", _name_of(type(value)))

    def _code(self, code: types.CodeType, doc: str | None) -> None:
        """Operations, constants and names of what is looked up; not the names of variables, lines, or the docstring."""
        self.word("code", code.co_code.hex(), code.co_argcount, code.co_kwonlyargcount, code.co_flags, code.co_names)
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                self._code(constant, None)
            elif constant != doc or doc is None:
                self.value(constant)


def _used_globals(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """What a function and those within it look up in their module, and in modules of the user's named there."""
    names = _names_in(function.__code__)
    for name in names:
        if name not in function.__globals__:
            continue
        used = function.__globals__[name]
        yield name, used
        if isinstance(used, types.ModuleType) and not _is_installed_module(used):
            yield from ((f"{name}.{inner}", getattr(used, inner)) for inner in names if hasattr(used, inner))


def _used_of_modules(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """What a function may look up in modules of the user's that it closes over, or imports itself."""
    names = _names_in(function.__code__)
    inside = [cell.cell_contents for cell in function.__closure__ or () if cell != types.CellType()]  # not one unfilled
    modules = [*inside, *(sys.modules.get(name) for name in names if name not in function.__globals__)]
    own = (each for each in modules if isinstance(each, types.ModuleType) and not _is_installed_module(each))
    for module in own:
        yield from ((f"{module.__name__}.{name}", getattr(module, name)) for name in names if hasattr(module, name))


def _is_installed_module(module: types.ModuleType) -> bool:
    return is_installed(module.__name__, getattr(module, "__file__", None))


_STATELESS = (
    type(None), bool, int, float, complex, str, bytes, tuple, type, types.ModuleType, types.FunctionType,
    types.BuiltinFunctionType, functools.partial, property, staticmethod, classmethod,
)  # fmt: skip
"""What does not change by being used."""


@functools.lru_cache(maxsize=1024)
def _assigned_in(code: types.CodeType) -> frozenset[str]:
    """Names outside a function that it, or one within it, assigns to."""
    words = ("STORE_GLOBAL", "STORE_DEREF", "DELETE_GLOBAL", "DELETE_DEREF")
    names = {str(each.argval) for each in dis.get_instructions(code) if each.opname in words}
    inner = (_assigned_in(constant) for constant in code.co_consts if isinstance(constant, types.CodeType))
    return frozenset(names.union(*inner))


def _names_in(code: types.CodeType) -> list[str]:
    names = dict.fromkeys(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            names.update(dict.fromkeys(_names_in(constant)))
    return list(names)


def _is_of_jax(value: Any) -> bool:
    return type(value).__module__.split(".")[0] in ("jax", "jaxlib") and not callable(
        getattr(value, "__wrapped__", None)
    )


def _top(module: str | None) -> str:
    return (module or "").split(".")[0]


def _is_versioned(module: str | None) -> bool:
    """Whether a version tells code: of the package, of those that it stands on, and of Python."""
    told, top = settings.current(), _top(module)
    return top == told.package or top in told.versioned or (top in sys.stdlib_module_names and top != "__main__")


@functools.lru_cache(maxsize=1)
def _installed_folders() -> tuple[str, ...]:
    paths = sysconfig.get_paths()
    folders = [paths[key] for key in ("stdlib", "platstdlib", "purelib", "platlib")]
    return tuple(str(Path(each)) for each in (*folders, site.getusersitepackages()))


def is_installed(module: str | None, file: str | None) -> bool:
    """Whether code belongs to Python, an installed package or this one: their versions tell them."""
    top = _top(module)
    if top == settings.current().package or top in sys.builtin_module_names or top in sys.stdlib_module_names:
        return top != "__main__"
    file = file or getattr(sys.modules.get(module or ""), "__file__", None)
    if file is None or file.startswith(("<frozen", *_installed_folders())):
        return file is not None
    return not file.startswith("<") and _is_distributed(file, tuple(sys.path))


@functools.lru_cache(maxsize=4096)
def _is_distributed(file: str, path: tuple[str, ...]) -> bool:
    """Whether a file belongs to a package that an installer has put into a folder of the search path.

    So packages of a cluster's modules (PYTHONPATH), of `pip install --target` and of `uv run --with` are known, which
    are in none of the interpreter's own folders. A user's modules may lie beside them: only what a distribution lists
    is installed.
    """
    for entry in path:
        folder = os.path.join(os.path.abspath(entry), "")
        if file.startswith(folder):
            if os.path.basename(folder[:-1]) in ("site-packages", "dist-packages"):
                return True
            if file[len(folder) :].split(os.sep)[0] in _distributed_in(folder):
                return True
    return False


@functools.lru_cache(maxsize=64)
def _distributed_in(folder: str) -> frozenset[str]:
    """Folders and files of distributions that were installed into a folder.

    Those have a list of their files, `RECORD`. A project that its developer has installed (`pip install -e`) has none
    in its own folder, where `egg-info` lies: its code changes, and its version does not.
    """
    listed = (distribution.read_text("RECORD") or "" for distribution in distributions(path=[folder]))
    # A line is a path, a hash and a size; paths have slashes on all systems.
    return frozenset(line.split(",")[0].split("/")[0].strip('"') for text in listed for line in text.splitlines())


def _is_in_package(module: str | None, file: str | None) -> bool:
    """Whether the file of a function lies within its module's package: not where `functools.wraps` has lent a name."""
    folders = getattr(sys.modules.get(_top(module)), "__path__", None)
    return file is None or any(file.startswith(os.path.join(folder, "")) for folder in folders or ())


def _name_of(value: Any) -> str:
    return f"{value.__module__}.{value.__qualname__}"


def _as_list(slots: Any) -> list[str]:
    return [slots] if isinstance(slots, str) else list(slots)


def _without_addresses(text: str) -> str:
    return re.sub(r" at 0x[0-9a-f]+|id=\d+", "", text)
