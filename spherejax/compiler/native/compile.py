"""Scalar programs as machine code of their own, which XLA calls.

XLA takes a millisecond for each operation of a large straight line: it cuts it into hundreds of fusions with buffers
between them. LLVM itself, asked for one function, takes a twentieth of that. So where a program is large (a film's
linear systems, its derivatives, a robot arm), its operations are written in LLVM's language, compiled by llvmlite, and
given to XLA as the target of a custom call, by the binary interface of `jax.ffi` (`xla/ffi/api/c_api.h`).

A loop that calls something is no longer one native function; `loop_fusion` sees to what is between the calls.

Programs are made so inside `native_code()`, on the processor, on the platforms that this has been tested on
(`platforms`), and with the versions of jaxlib that this is known to work with. Anywhere else XLA compiles them as
before.
`SPHEREJAX_MACHINE_CODE=0` switches it off.
"""

import ctypes
import hashlib
import os
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib.metadata import version
from typing import Any

import jax
import jax.ffi

from spherejax.compiler import private
from spherejax.compiler.emit.llvm import FUNCTION, FunctionText
from spherejax.compiler.hooks import attached
from spherejax.compiler.native import platforms
from spherejax.compiler.native.ffi_abi import KNOWN_JAXLIB, REGISTERED_API_VERSION

# Whether --------------------------------------------------------------------------------------------------------------


@cache
def is_available() -> bool:
    """Whether programs can be made so in this process; where the installation is why not, one warning says so."""
    if os.environ.get(platforms.SETTING, "") == "0" or jax.default_backend() != "cpu":
        return False
    if name := platforms.untested():
        # Nothing that could be installed would change it, so this is short.
        warnings.warn(
            f"spherejax compiles no machine code of its own on {name}, where that has not been tested; XLA compiles "
            "everything: the numbers are the same up to rounding, first calls take two to eight times as long. "
            f"{platforms.SETTING}=0 hides this message, {platforms.SETTING}=1 tries it.",
            attached().warning,
            stacklevel=2,
        )
        return False
    if missing := _what_is_missing():
        why, remedy = missing
        # Compiled anew with jaxlib 0.6.1: a dry run 1.9, of many 2.3, with its derivative 6.8 times as long.
        warnings.warn(
            f"spherejax cannot compile its own machine code: {why}. XLA compiles everything instead: the numbers are "
            "the same up to rounding, but first calls take two to eight times as long, and films and sweeps run up to "
            f"twice as long. {remedy} {platforms.SETTING}=0 to hear no more of it.",
            attached().warning,
            stacklevel=2,
        )
    return not missing


def _what_is_missing() -> tuple[str, str] | None:
    """Why machine code cannot be compiled here, and what to do, up to "set ..."; None where it can."""
    installed = version("jaxlib")
    first, last = KNOWN_JAXLIB
    known = " to ".join(f"{major}.{minor}" for major, minor in KNOWN_JAXLIB)
    remedy = f"Install jax and jaxlib {known}, or set"
    if not first <= tuple(int(part) for part in installed.split(".")[:2]) <= last:
        return f"it has not been tried with jaxlib {installed}", remedy
    if not hasattr(jax, "make_user_context"):
        return f"jax {jax.__version__} has no make_user_context", remedy
    try:
        import llvmlite.binding as llvm

        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
    except Exception as error:  # not installed, or not for this processor
        return f"llvmlite cannot be used ({type(error).__name__}: {error})", "Install llvmlite, or set"
    if platforms.this_platform() != platforms.ALL_TESTS_RUN_ON and (why := platforms.check(llvm)):
        return why, "Report it, and set"
    return None


# JAX traces again what it has traced in another context.
_context: Any = private.new_context()
_wanted = threading.local()


@contextmanager
def native_code(enabled: bool = True) -> Iterator[None]:
    """Programs that are traced within become machine code, or they do not; without `jax.jit` none could be called."""
    before = native_code_enabled()
    now = enabled and is_available() and not private.is_jit_disabled()
    if now == before:
        yield
        return
    with _context(now):
        _wanted.now = now
        try:
            yield
        finally:
            _wanted.now = before


def native_code_enabled() -> bool:
    """Whether programs that are traced now become machine code."""
    return getattr(_wanted, "now", False)


# Compiling ------------------------------------------------------------------------------------------------------------

# Re-entrant: `called_text` holds it while `target_of` takes it.
_lock = threading.RLock()
_loaded: dict[str, tuple[Any, bytes]] = {}
_listening = threading.local()


def called(
    line: Any,
    lanes: tuple[int, ...],
    axes: tuple[int, ...],
    added: tuple[int, ...] = (),
    deferred: tuple[int, ...] = (),
) -> str:
    """The target of a custom call that evaluates a line: compiled, or found where another process has left it.

    Args:
        line, lanes, axes, added, deferred: as of `FunctionText`.
    """

    def written() -> str:
        return FunctionText(line, lanes, axes, added=added, deferred=deferred).written()

    return called_text((lanes, axes, added, deferred), line, written, is_wide=bool(lanes))


def called_text(key: tuple, line: Any, written: Callable[[], str], *, is_wide: bool, is_optimised: bool = True) -> str:
    """As `called`, for what is written for a line.

    Args:
        key: tells what is written from other things for the same line.
        line: for which it is.
        written: the text.

    Other args:
        is_wide: most of it are long vectors.
        is_optimised: whether LLVM goes through it before it writes code.
    """
    with _lock:
        if key not in line.called:
            line.called[key] = target_of(written(), is_wide=is_wide, is_optimised=is_optimised)
        name = line.called[key]
    note_ffi_targets([name])
    return name


def target_of(text: str, *, is_wide: bool, is_optimised: bool, prefix: str = "spherejax_") -> str:
    """The target of a custom call for a text: compiled, or found where another process has left it.

    Args:
        text: of a function, and of all that it needs but other targets that it calls.

    Other args:
        is_wide, is_optimised: as of `called_text`.
        prefix: of the name.
    """
    text = _with_widths(text, is_wide)
    # All that the object code follows from, so that another process may take it by its name alone.
    facts = "\0".join([text, str(is_optimised), *_machine(is_wide, is_optimised)])
    name = prefix + hashlib.sha256(facts.encode()).hexdigest()[:32]
    with _lock:
        if name not in _loaded:
            stored = attached().lookup(name)
            if isinstance(stored, bytes):
                with suppress(Exception):  # whatever is wrong with it: it is compiled anew
                    _load(name, stored)
        if name not in _loaded:
            # Named after its digest in the process, too: symbols of LLVM's engines are one namespace.
            content = _compiled(text.replace(f"@{FUNCTION}", f"@{name}"), is_wide, is_optimised)
            attached().save(name, content)
            _load(name, content)
    return name


TARGETS: dict[str, Callable[..., str]] = {}
"""Operations that are calls of machine code: of each the target, from what its arguments are and its parameters."""


def note_ffi_targets(names: Iterable[str]) -> None:
    """Programs that what is lowered now calls; see `record_ffi_targets`."""
    recorded = getattr(_listening, "names", None)
    if recorded is not None:
        recorded.update(names)


@contextmanager
def record_ffi_targets() -> Iterator[Callable[[], dict[str, bytes]]]:
    """A function that gives the machine code of all programs that were lowered in the context, by name."""
    before, _listening.names = getattr(_listening, "names", None), set()
    names = _listening.names
    try:
        yield lambda: {name: _loaded[name][1] for name in sorted(names)}
    finally:
        _listening.names = before
        if before is not None:  # a recorder around this one records what was lowered within, too
            before |= names


def register_object_code(codes: dict[str, bytes]) -> None:
    """Machine code that another process has made, for a compiled program that calls it."""
    if codes and not is_available():
        raise RuntimeError("this process cannot run machine code of another one")
    with _lock:
        for name, content in codes.items():
            if name not in _loaded:
                _load(name, content)


@cache
def _machine(is_wide: bool, is_optimised: bool) -> tuple[str, ...]:
    """What code is made for, and by what.

    Vectors of 512 bits are left out where most numbers stand alone: with a few of them among the others (the sums
    over stages) single runs of a four-bar take a tenth (dry) to a quarter (bushing) longer on an Intel Xeon, and their
    derivatives a fifth to a third. Groups of eight runs take a tenth less with them. The 32 registers that come with
    them are used all the same, by vectors of 256 bits: 2 to 5 percent less for a run, 4 to 10 for derivatives. Not in
    what is not optimised: it takes a twelfth longer to compile, and gains 2.
    """
    import llvmlite
    import llvmlite.binding as llvm

    triple, name, features = platforms.host(llvm)
    if not (is_wide or is_optimised):
        features = features.replace("+avx512", "-avx512")
    # The triple is part of what is kept: on ARM processors of several systems have the same name, "generic".
    return triple, name, features, llvmlite.__version__


_PLAIN, _OF_256_BITS = " nounwind {", ' nounwind "prefer-vector-width"="256" "min-legal-vector-width"="256" {'
"""How functions begin. The attributes are those of x86; LLVM ignores them on other processors."""


def _with_widths(text: str, is_wide: bool) -> str:
    """A text whose functions say how long their vectors may be."""
    return text if is_wide else text.replace(_PLAIN, _OF_256_BITS)


def _target_machine(is_wide: bool, is_optimised: bool = True) -> Any:
    import llvmlite.binding as llvm

    triple, name, features, _ = _machine(is_wide, is_optimised)
    # Of the process: the default triple is that of the machine on which llvmlite was built.
    target = llvm.Target.from_triple(triple)
    how = {"opt": 1, "reloc": "pic", "codemodel": "jitdefault", "jit": True}
    return target.create_target_machine(cpu=name, features=features, **how)


def _compiled(text: str, is_wide: bool, is_optimised: bool) -> bytes:
    """Machine code of a text, by LLVM with few optimisations: more of them take longer and give nothing here."""
    import llvmlite.binding as llvm

    module = llvm.parse_assembly(text)
    machine = _target_machine(is_wide, is_optimised)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    if is_optimised:
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
        builder.getModulePassManager().run(module, builder)
    return machine.emit_object(module)


def _load(name: str, content: bytes) -> None:
    import llvmlite.binding as llvm

    # An engine of its own, with an empty module: it only loads the object code.
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _target_machine(is_wide=True))
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    address = engine.get_function_address(name)
    if not address:
        raise RuntimeError(f"no function {name} in its machine code")
    llvm.add_symbol(name, address)  # for what calls it without XLA
    jax.ffi.register_ffi_target(name, _capsule(address), platform="cpu", api_version=REGISTERED_API_VERSION)
    _loaded[name] = engine, content  # for as long as the process lives: XLA does not forget targets


def _capsule(address: int) -> Any:
    make = ctypes.pythonapi.PyCapsule_New
    make.restype, make.argtypes = ctypes.py_object, [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    return make(address, None, None)
