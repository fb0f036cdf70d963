"""The operating systems and processors on which native code is made, and a check that it computes there.

The code is LLVM's, and the text it is made from names no processor: vectors of eight numbers are four registers on ARM
(NEON), two on x86 with AVX2, one with AVX-512. What differs between platforms is the loader (object formats, memory
that may be executed), the mathematical library, and what LLVM calls by itself. None of that can be tested without such
a machine. So native code is made where tests have run; elsewhere XLA compiles everything, unless native code is
requested (`SPHEREJAX_MACHINE_CODE=1`).
"""

import ctypes
import math
import os
import platform
from typing import Any

from spherejax.compiler.emit.llvm import Numbers
from spherejax.compiler.emit.llvm_functions import FUNCTIONS, OF_VECTORS_ALONE
from spherejax.compiler.operations import LIBRARY, OPERATIONS

SETTING = "SPHEREJAX_MACHINE_CODE"
"""Environment variable: 0 switches native code off, 1 asks for it on a platform that has not been tested."""

ALL_TESTS_RUN_ON = ("Linux", "x86_64")
TESTED = (ALL_TESTS_RUN_ON, ("Linux", "aarch64"))
"""Operating systems and processors. On ARM runs of each kind, emulated by QEMU, have had the numbers of x86."""

_PROCESSORS = {"amd64": "x86_64", "x64": "x86_64", "arm64": "aarch64"}
"""Linux's names by those of Windows and macOS."""
_SYSTEMS = {"Darwin": "macOS"}


def this_platform() -> tuple[str, str]:
    """The operating system and the processor, by Linux's names: ("Linux", "x86_64"), ("Darwin", "aarch64"), ..."""
    machine = platform.machine().lower()
    return platform.system(), _PROCESSORS.get(machine, machine)


def is_requested() -> bool:
    """Whether native code is asked for on whatever platform."""
    return os.environ.get(SETTING, "") == "1"


def untested() -> str:
    """The name of this platform if native code has not been tested on it, and was not requested; empty otherwise."""
    system, processor = this_platform()
    if (system, processor) in TESTED or is_requested():
        return ""
    return f"{_SYSTEMS.get(system, system or 'an unknown system')} ({processor or 'unknown processor'})"


def host(llvm: Any) -> tuple[str, str, str]:
    """Triple, processor and features that code is made for, of this process.

    Args:
        llvm: `llvmlite.binding`.
    """
    try:
        features = llvm.get_host_cpu_features().flatten()
    except RuntimeError:  # llvmlite up to 0.44, where LLVM cannot tell them; the processor's name implies most
        features = ""
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features


# A small program ------------------------------------------------------------------------------------------------------

NUMBERS = (0.5, -0.5, 1.5, -2.5, 2.0**-40, 3.25, -1e300, 0.75)
"""One vector. Halves show how a number is rounded to a whole one."""

ROOM = 20_000
"""Numbers on the stack of the program, 160 kB. On Windows a function with more than a page calls `__chkstk`."""


def check(llvm: Any) -> str:
    """Compile and run a small program: why native code cannot be used here, in words; empty where it can.

    It calls each function of the mathematical library once, or ours in its place, rounds a vector of numbers, and uses
    the stack. Missing symbols are looked for before that: LLVM ends the process over one.

    Args:
        llvm: `llvmlite.binding`, with its native target initialized.
    """
    try:
        llvm.check_jit_execution()  # systems with hardened memory forbid it
        triple, cpu, features = host(llvm)
        how = {"opt": 1, "reloc": "pic", "codemodel": "jitdefault", "jit": True}
        machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features=features, **how)
        # The symbols of the process are known to LLVM from its first engine on.
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)
        needed = [word for word in sorted(LIBRARY.values()) if word not in FUNCTIONS or word in OF_VECTORS_ALONE]
        needed += ["memset", "memcpy"]
        needed += ["__chkstk"] if platform.system() == "Windows" else []
        missing = [name for name in needed if not llvm.address_of_symbol(name)]
        if missing:
            return f"this process has no function {', '.join(missing)}"
        module = llvm.parse_assembly(_text())
        module.triple, module.data_layout = triple, str(engine.target_data)
        engine.add_module(module)
        engine.finalize_object()
        results = (ctypes.c_double * (len(LIBRARY) + len(NUMBERS) + 1))()
        numbers = (ctypes.c_double * len(NUMBERS))(*NUMBERS)
        program = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(engine.get_function_address("check"))
        program(ctypes.addressof(numbers), ctypes.addressof(results))
    except Exception as error:
        return f"a small program cannot be compiled ({type(error).__name__}: {error})"
    for name, value, right in zip(
        [*sorted(LIBRARY), *["vectors"] * (len(NUMBERS) + 1)], results, expected(), strict=True
    ):
        # Mathematical libraries differ in their last digit.
        if not math.isclose(value, right, rel_tol=1e-15, abs_tol=0.0):
            return f"a small program has wrong numbers ({name}: {value!r}, not {right!r})"
    return ""


def expected() -> list[float]:
    """What the program of `check` has to compute."""
    of_library = [getattr(math, LIBRARY[name])(*OPERATIONS[name].example) for name in sorted(LIBRARY)]
    of_vectors = [max(float(round(x)), 0.25) + math.sqrt(abs(x)) for x in NUMBERS]  # Python rounds halves to even
    return [*of_library, *of_vectors, float(ROOM)]


def _text() -> str:
    """The program of `check`, in LLVM's language: from (numbers, results) to the results that `expected` lists."""
    n = len(NUMBERS)
    vector = f"<{n} x double>"
    lines: list[str] = []
    declared: dict[str, None] = {}

    def made(text: str) -> str:
        lines.append(f"  %v{len(lines)} = {text}")
        return f"%v{len(lines) - 1}"

    writer = Numbers(made, declared, 1)
    for i, name in enumerate(sorted(LIBRARY)):
        value = writer.library(LIBRARY[name], *(writer.number(x, "double") for x in OPERATIONS[name].example))
        lines.append(f"  store double {value}, ptr {made(f'getelementptr inbounds double, ptr %to, i64 {i}')}, align 8")
    quarter = ", ".join(["double 0.25"] * n)
    return "\n".join(
        [
            *declared,
            *(f"declare {vector} @llvm.{word}.v{n}f64({vector})" for word in ("roundeven", "fabs", "sqrt")),
            f"declare {vector} @llvm.maximum.v{n}f64({vector}, {vector})",
            "define void @check(ptr %from, ptr noalias %to) {",
            "start:",
            *lines,
            f"  %x = load {vector}, ptr %from, align 8",
            f"  %whole = call {vector} @llvm.roundeven.v{n}f64({vector} %x)",
            f"  %most = call {vector} @llvm.maximum.v{n}f64({vector} %whole, {vector} <{quarter}>)",
            f"  %size = call {vector} @llvm.fabs.v{n}f64({vector} %x)",
            f"  %root = call {vector} @llvm.sqrt.v{n}f64({vector} %size)",
            f"  %sum = fadd {vector} %most, %root",
            f"  %p = getelementptr inbounds double, ptr %to, i64 {len(LIBRARY)}",
            f"  store {vector} %sum, ptr %p, align 8",
            # All of the room is written to and added up; volatile, or LLVM would do without it.
            f"  %room = alloca [{ROOM} x double], align 64",
            "  br label %fill",
            "fill:",
            "  %i = phi i64 [0, %start], [%i.next, %fill]",
            "  %q = getelementptr inbounds double, ptr %room, i64 %i",
            "  store volatile double 1.0, ptr %q, align 8",
            "  %i.next = add i64 %i, 1",
            f"  %is.full = icmp sge i64 %i.next, {ROOM}",
            "  br i1 %is.full, label %add, label %fill",
            "add:",
            "  %j = phi i64 [0, %fill], [%j.next, %add]",
            "  %total = phi double [0.0, %fill], [%more, %add]",
            "  %r = getelementptr inbounds double, ptr %room, i64 %j",
            "  %one = load volatile double, ptr %r, align 8",
            "  %more = fadd double %total, %one",
            "  %j.next = add i64 %j, 1",
            f"  %is.done = icmp sge i64 %j.next, {ROOM}",
            "  br i1 %is.done, label %end, label %add",
            "end:",
            f"  %last = getelementptr inbounds double, ptr %to, i64 {len(LIBRARY) + n}",
            "  store double %more, ptr %last, align 8",
            "  ret void",
            "}",
            "",
        ]
    )
