"""The functions of `spherejax.compiler.emit.llvm_functions`: their coefficients, their errors and their times.

    python benchmarks/fitted_functions.py                  # errors and times, 3 minutes
    python benchmarks/fitted_functions.py --coefficients   # prints the coefficients, half a minute

A polynomial, or a quotient of two, is fitted so that its largest error is the smallest there is (E. Remez 1934: the
error alternates between as many equal extremes as there are unknowns), with decimal numbers of 60 digits. Errors are in
units of the last digit, against the same decimal numbers; beside them those of the system's mathematical library. Times
are nanoseconds of a number: alone, and in a vector of eight; one behind the other, and where each waits for the last.
"""

import argparse
import ctypes
import decimal
import math
import sys
import time
from collections.abc import Callable, Sequence
from decimal import Decimal
from functools import cache
from pathlib import Path

from machine import use_one_core, write

use_one_core()
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

import numpy as np  # noqa: E402
from exact_functions import BEGINS, EXACT, tanh, two_pi  # noqa: E402

from spherejax.compiler.emit.llvm import Numbers  # noqa: E402
from spherejax.compiler.emit.llvm_functions import FUNCTIONS  # noqa: E402
from spherejax.compiler.native.platforms import host  # noqa: E402

Function = Callable[[Decimal], Decimal]

# Decimal numbers ------------------------------------------------------------------------------------------------------


def series(x: Decimal, first: int) -> Decimal:
    """(e^x - its terms before x^first) / x^first."""
    total, term = Decimal(0), 1 / Decimal(math.factorial(first))
    for k in range(first + 1, first + 60):
        total, term = total + term, term * x / k
    return total


def artanh(x: Decimal, first: int = 0) -> Decimal:
    """Its terms from x^(2 first + 1) on, over this power; for |x| below 0.2."""
    return sum((x ** (2 * k) / (2 * (first + k) + 1) for k in range(50)), Decimal(0))


def alternating(square: Decimal, first: int) -> Decimal:
    """The terms of a circular function from x^first on, over this power; the sign of the first one is positive."""
    total, term = Decimal(0), 1 / Decimal(math.factorial(first))
    for k in range(first + 1, first + 60, 2):
        total, term = total + term, -term * square / (k * (k + 1))
    return total


def hyperbolic(square: Decimal, first: int) -> Decimal:
    """The same of a hyperbolic function."""
    return alternating(-square, first)


def solved(rows: list[list[Decimal]]) -> list[Decimal]:
    """The solution of a linear system, whose right-hand sides stand last in its rows."""
    n = len(rows)
    for i in range(n):
        pivot = max(range(i, n), key=lambda k: abs(rows[k][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for k in range(i + 1, n):
            factor = rows[k][i] / rows[i][i]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[i], strict=True)]
    x: list[Decimal] = []
    for row in reversed(rows):
        known = sum((a * b for a, b in zip(reversed(row[:-1]), x, strict=False)), Decimal(0))
        x.append((row[-1] - known) / row[n - 1 - len(x)])
    return x[::-1]


def value(coefficients: Sequence[Decimal], x: Decimal) -> Decimal:
    total = Decimal(0)
    for c in reversed(coefficients):
        total = total * x + c
    return total


def fitted(function: Function, weight: Function, low: Decimal, high: Decimal, above: int, below: int = 0):
    """Polynomials P and Q of these degrees, Q(0) = 1, and the largest of |P / Q - function| weight, which is least."""
    n = above + below + 2

    def points(count: int, shift: float) -> list[Decimal]:  # denser towards the ends, as the extremes are
        return [
            (low + high) / 2 - (high - low) / 2 * Decimal(math.cos(math.pi * (i + shift) / count)) for i in range(count)
        ]

    extremes, error = points(n, 0.5), Decimal(0)
    while True:
        for _ in range(1 if below == 0 else 12):  # the error stands in a product with Q
            rows = []
            for i, x in enumerate(extremes):
                f, sign = function(x), (-1) ** i / weight(x)
                rows.append(
                    [x**k for k in range(above + 1)]
                    + [-(f + sign * error) * x**k for k in range(1, below + 1)]
                    + [-sign, f]
                )
            *unknowns, error = solved(rows)
        p, q = unknowns[: above + 1], [Decimal(1), *unknowns[above + 1 :]]
        best: list[tuple[Decimal, Decimal]] = []  # the largest error of each sign in turn
        for x in [low, *points(30 * n, 0.5), high]:
            e = (value(p, x) / value(q, x) - function(x)) * weight(x)
            if best and (e > 0) == (best[-1][1] > 0):
                best[-1] = max(best[-1], (x, e), key=lambda pair: abs(pair[1]))
            else:
                best.append((x, e))
        while len(best) > n:
            best.pop(0 if abs(best[0][1]) < abs(best[-1][1]) else -1)
        extremes, sizes = [x for x, _ in best], [abs(e) for _, e in best]
        if max(sizes) < Decimal("1.001") * min(sizes):
            return p, q, max(sizes)


def coefficients() -> None:
    one, half = Decimal(1), Decimal(2).ln() / 2 * Decimal("1.0001")  # a little more: n is rounded
    first = Decimal(math.floor(Decimal(2).ln() * 2**42)) / 2**42
    quarter = two_pi() / 4
    begin = Decimal(math.floor(quarter * 2**35)) / 2**35
    then = Decimal(math.floor((quarter - begin) * 2**71)) / 2**71
    print("half of pi:", float(begin), float(then), float(quarter - begin - then), "its inverse:", float(1 / quarter))
    print("logarithm of 2:", float(first), float(Decimal(2).ln() - first), "its inverse:", float(1 / Decimal(2).ln()))

    def of_tanh(square: Decimal) -> Decimal:
        x = square.sqrt()
        return (tanh(x) / x - 1) / square

    tiny, in_hyperbolic, in_circular = Decimal("1e-12"), half * half, (two_pi() / 8 * Decimal("1.0001")) ** 2
    largest = ((Decimal(2).sqrt() - 1) / (Decimal(2).sqrt() + 1)) ** 2
    fits = {
        "sine": fitted(lambda u: -alternating(u, 3), lambda u: one, tiny, in_circular, 5),
        "cosine": fitted(lambda u: alternating(u, 4), lambda u: one, tiny, in_circular, 5),
        "sinh": fitted(lambda u: hyperbolic(u, 3), lambda u: one, tiny, in_hyperbolic, 4),
        "cosh": fitted(lambda u: hyperbolic(u, 2), lambda u: one, tiny, in_hyperbolic, 4),
        "logarithm": fitted(lambda u: 2 * artanh(u.sqrt(), 1), lambda u: one, Decimal("1e-12"), largest, 6),
        "exponential": fitted(lambda r: series(r, 2), lambda r: one, -half, half, 10),
        "tanh": fitted(of_tanh, lambda u: u, Decimal("1e-12"), Decimal("0.625") ** 2, 2, 3),
    }
    for name, (p, q, error) in fits.items():
        print(name, [float(c) for c in p], [float(c) for c in q], f"within {error:.2g}")


# Errors and times -----------------------------------------------------------------------------------------------------


def function_text(name: str, width: int, is_ours: bool, waits: bool) -> str:
    """A function of (x, y, n, turns) that writes all results, again and again."""
    lines: list[str] = []
    declared: dict[str, None] = {}

    def made(text: str) -> str:
        lines.append(f"  %v{len(lines)} = {text}")
        return f"%v{len(lines) - 1}"

    writer = Numbers(made, declared, width)
    typed, zero = writer.type("double"), writer.number(0.0, "double")
    made("getelementptr double, ptr %x, i64 %i")
    made("getelementptr double, ptr %y, i64 %i")
    argument = made(f"load {typed}, ptr %v0, align 8")
    if waits:
        argument = made(f"fadd {typed} {argument}, {made(f'fmul {typed} %before, {zero}')}")
    if is_ours:
        result = writer.ours(name, argument)
    else:
        declared[f"declare double @{name}(double) nounwind willreturn memory(none)"] = None
        result = made(f"call double @{name}(double {argument})")
    return "\n".join(
        [
            *declared,
            "define void @run(ptr %x, ptr noalias %y, i64 %n, i64 %turns) nounwind {",
            "begin:\n  br label %turn\nturn:",
            "  %t = phi i64 [0, %begin], [%t.next, %turn.end]",
            "  br label %one\none:",
            "  %i = phi i64 [0, %turn], [%next, %one]",
            f"  %before = phi {typed} [{zero}, %turn], [{result}, %one]",
            *lines,
            f"  store {typed} {result}, ptr %v1, align 8",
            f"  %next = add i64 %i, {width}",
            "  %more = icmp slt i64 %next, %n",
            "  br i1 %more, label %one, label %turn.end\nturn.end:",
            "  %t.next = add i64 %t, 1",
            "  %again = icmp slt i64 %t.next, %turns",
            "  br i1 %again, label %turn, label %end\nend:\n  ret void\n}",
        ]
    )


@cache
def compiled(name: str, width: int = 1, is_ours: bool = True, waits: bool = False, is_fused: bool = True):
    """From an array, and how often, to the results.

    Other args:
        is_fused: for this processor; otherwise for the first ones of its kind, which have no fused operations.
    """
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly(function_text(name, width, is_ours, waits))
    triple, cpu, features = host(llvm)
    cpu, features = (cpu, features) if is_fused else ("", "")
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features=features, opt=1, jit=True)
    options = llvm.create_pipeline_tuning_options(speed_level=1)
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    address = engine.get_function_address("run")
    run = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64)(address)

    def evaluated(x: np.ndarray, turns: int = 1) -> np.ndarray:
        assert engine
        assert x.size % width == 0
        y = np.empty_like(x)
        run(x.ctypes.data, y.ctypes.data, x.size, turns)
        return y

    return evaluated


def arguments() -> np.ndarray:
    rng = np.random.default_rng(0)
    parts = [rng.uniform(-bound, bound, 20_000) for bound in (1.0, 3.0, 20.0, 745.0)]
    small = 10.0 ** rng.uniform(-320, 0, 20_000) * rng.choice([-1, 1], 20_000)
    changes = [math.log(2) / d * k * (1 + e) for k in range(-1074, 1024) for d in (1, 2) for e in (0, 1e-15, -1e-15)]
    return np.concatenate(
        [*parts, small, changes, 2.0 ** rng.uniform(-1074, 1023, 20_000), rng.uniform(0.5, 2, 20_000)]
    )


def largest_error(name: str, run: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> float:
    """In units of the last digit; infinite where an infinity is wrong."""
    worst, limit = 0.0, Decimal(2) ** 1024 - Decimal(2) ** 970
    x = x[x > BEGINS[name]] if name in BEGINS else np.clip(x, -2000, 2000)
    x = x * 50 if name in ("sin", "cos") else x
    for argument, result in zip(x, run(x), strict=True):
        exact = EXACT[name](Decimal(float(argument)))
        if abs(exact) >= limit or not math.isfinite(result):
            worst = worst if abs(exact) >= limit and not math.isfinite(result) else math.inf
            continue
        worst = max(worst, float(abs(Decimal(float(result)) - exact) / Decimal(math.ulp(float(exact)))))
    return worst


def nanoseconds(name: str, run: Callable[..., np.ndarray], bound: float) -> float:
    low = BEGINS[name] + 0.5 if name in BEGINS else -bound
    x = np.random.default_rng(1).uniform(low, bound, 1024)
    times = []
    for _ in range(40):
        begin = time.perf_counter()
        run(x, 50)
        times.append(time.perf_counter() - begin)
    return 1e9 * min(times) / (50 * x.size)


def rows() -> list[dict[str, object]]:
    x, table = arguments(), []
    for name in sorted(FUNCTIONS):
        library = compiled(name, is_ours=False)
        row: dict[str, object] = {
            "function": name,
            "error [ulp]": f"{largest_error(name, compiled(name), x):.3f}",
            "without fused operations": f"{largest_error(name, compiled(name, is_fused=False), x):.3f}",
            "of the library": f"{largest_error(name, library, x):.3f}",
        }
        for bound in (1.0, 8.0):
            times = {
                "ns": compiled(name),
                "ns in a vector": compiled(name, 8),
                "ns by the library": library,
                "ns waiting": compiled(name, waits=True),
                "ns waiting, by the library": compiled(name, is_ours=False, waits=True),
            }
            row |= {f"{what} (x < {bound:g})": f"{nanoseconds(name, run, bound):.2f}" for what, run in times.items()}
        table.append(row)
    return table


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coefficients", action="store_true", help="print the coefficients, and measure nothing")
    decimal.setcontext(decimal.Context(prec=60, Emax=10**6, Emin=-(10**6)))
    if parser.parse_args().coefficients:
        coefficients()
    else:
        write("fitted_functions", "python benchmarks/fitted_functions.py", rows())
