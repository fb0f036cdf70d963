"""Our own mathematical functions, against decimal numbers of many digits; a number and a vector get the same bits."""

import ctypes
import decimal
import math
from collections.abc import Callable
from decimal import Decimal
from functools import cache

import numpy as np
import pytest
from exact_functions import BEGINS, EXACT

from spherejax.compiler.emit.llvm import Numbers
from spherejax.compiler.emit.llvm_functions import FUNCTIONS, LARGEST_ANGLE, WITHIN
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.platforms import host

pytestmark = pytest.mark.skipif(not machine_code.is_available(), reason="no machine code with this jaxlib")

DIGITS = decimal.Context(prec=60, Emax=10**6, Emin=-(10**6))


def test_every_function_is_tested():
    assert EXACT.keys() == FUNCTIONS.keys()


def numbers() -> np.ndarray:
    """Where something changes (signs, powers of two, ends of polynomials, overflow), and many by chance."""
    rng = np.random.default_rng(0)
    ends = [
        0.0,
        5e-324,
        1e-310,
        2.0**-1022,
        1e-300,
        1e-16,
        0.625,
        20.0,
        45.0,
        708.4,
        709.782712893384,
        710.4758600739439,
        745.14,
        750.0,
    ]
    ends = [*ends, 1e4, 1e300, np.inf]
    changes = [math.log(2) * (k + 0.5) for k in range(-3, 4)] + [-745.1332191019411, -708.39, -744.4400719213812]
    around = np.concatenate([np.nextafter(ends, 0), ends, np.nextafter(ends, np.inf)])
    wide = 10.0 ** rng.uniform(-320, 3, 300) * rng.choice([-1, 1], 300)
    parts = [rng.uniform(-bound, bound, 400) for bound in (1.0, 3.0, 20.0, 750.0)]
    roots = [np.sqrt(0.5) * 2.0**k * (1 + e) for k in (-1074, -1022, -3, 0, 1, 1023) for e in (-1e-15, 0, 1e-15)]
    logarithms = [*roots, *(np.array(roots) - 1.0), -1 + 1e-16, -1 - 2e-16, *10.0 ** rng.uniform(3, 308, 100)]
    angles = [k * np.pi / 2 * (1 + e) for k in (1, 2, 3, 4, 5, 63661, 63662, 10**6) for e in (0, 1e-16, -1e-12)]
    angles = [*angles, LARGEST_ANGLE, *rng.uniform(-LARGEST_ANGLE, LARGEST_ANGLE, 300)]
    logarithms += angles
    return np.concatenate([around, -around, changes, [np.nan], *parts, wide, logarithms])


@cache
def compiled(name: str, width: int) -> Callable[[np.ndarray], np.ndarray]:
    """A function of arrays, so many numbers at a time; without JAX, which takes subnormal numbers for zero."""
    import llvmlite.binding as llvm

    lines, declared = [], {}

    def made(text: str) -> str:
        lines.append(f"  %v{len(lines)} = {text}")
        return f"%v{len(lines) - 1}"

    writer = Numbers(made, declared, width)
    typed = writer.type("double")
    made("getelementptr double, ptr %x, i64 %i")
    made("getelementptr double, ptr %y, i64 %i")
    result = writer.ours(name, made(f"load {typed}, ptr %v0, align 8"))
    text = [
        *declared,
        "define void @run(ptr %x, ptr noalias %y, i64 %n) nounwind {",
        "begin:",
        "  br label %turn",
        "turn:",
        "  %i = phi i64 [0, %begin], [%next, %turn]",
        *lines,
        f"  store {typed} {result}, ptr %v1, align 8",
        f"  %next = add i64 %i, {width}",
        "  %more = icmp slt i64 %next, %n",
        "  br i1 %more, label %turn, label %end",
        "end:",
        "  ret void",
        "}",
    ]
    module = llvm.parse_assembly("\n".join(text))
    triple, cpu, features = host(llvm)
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features=features, opt=1, jit=True)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    run = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)(engine.get_function_address("run"))

    def evaluated(x: np.ndarray) -> np.ndarray:
        assert engine
        filled = np.concatenate([x, np.ones(-x.size % width)])
        y = np.empty_like(filled)
        run(filled.ctypes.data, y.ctypes.data, filled.size)
        return y[: x.size]

    return evaluated


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_it_is_within_two_units_of_the_last_digit(name):
    x = numbers()
    result = compiled(name, 1)(x)
    ordinary = np.isfinite(x) & (x > BEGINS.get(name, -np.inf))
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(result[~ordinary], getattr(np, name)(x[~ordinary]))
        np.testing.assert_array_equal(np.signbit(result[x == 0]), np.signbit(getattr(np, name)(x[x == 0])))
    largest, errors = Decimal(2) ** 1024 - Decimal(2) ** 970, []
    with decimal.localcontext(DIGITS):
        for argument, value in zip(x[ordinary], result[ordinary], strict=True):
            # Beyond 2000 exponentials are what they are there: infinite, zero, or one.
            at = argument if name in BEGINS or name in WITHIN else np.clip(argument, -2000, 2000)
            exact = EXACT[name](Decimal(float(at)))
            if not math.isfinite(value):
                assert abs(exact) >= largest
                assert (value > 0) == (exact > 0)
                continue
            unit = Decimal(math.ulp(float(min(abs(exact), largest - 1))))
            errors.append(abs(Decimal(float(value)) - exact) / unit)
    assert max(errors) <= 2
    assert max(errors) > Decimal("0.5")  # which it would be of the exact result, rounded: the units are right


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
@pytest.mark.parametrize("width", [2, 3, 4, 5, 8])
def test_a_number_and_a_vector_have_the_same_bits(name, width):
    x = numbers()
    alone, vectors = compiled(name, 1)(x), compiled(name, width)(x)
    np.testing.assert_array_equal(vectors, alone)
    np.testing.assert_array_equal(np.signbit(vectors[x == 0]), np.signbit(alone[x == 0]))


@pytest.mark.parametrize("name", sorted(FUNCTIONS.keys() - {"cos", "cosh", "sin"}))
def test_it_falls_nowhere_by_more_than_its_error(name):
    """From one number to the next, at ends of polynomials and where the power of two changes."""
    ends = [0.625, -0.625, 20.0, -45.0, *(math.log(2) / d * (k + 0.5) for d in (1, 2) for k in range(-4, 5))]
    ends += [math.sqrt(2), math.sqrt(8), math.sqrt(0.5), math.sqrt(2) - 1, math.sqrt(0.5) - 1]
    if name in BEGINS:
        ends = [end for end in ends if end > BEGINS[name]]
    steps = np.arange(-50, 51)
    x = np.concatenate([end + np.spacing(end) * np.sign(end) * steps for end in ends])
    result = compiled(name, 1)(x).reshape(len(ends), -1)
    assert np.all(np.diff(result, axis=1) >= -2 * np.spacing(np.abs(result[:, 1:])))
