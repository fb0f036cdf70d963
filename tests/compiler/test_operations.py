"""Each operation in each of its forms, against JAX: folded, evaluated, by XLA, as machine code, in C; its derivative.

A primitive that is admitted to `operations.OPERATIONS` gets a row of `ROWS`: what to write in JAX, and where its
argument may be. All else is the same for all.
"""

import ctypes
import dataclasses
import itertools
import shutil
import subprocess
from collections.abc import Callable, Set
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.core import ShapedArray
from jax.extend import core as jex

from spherejax.compiler import primitive
from spherejax.compiler.emit.c import PRELUDE
from spherejax.compiler.emit.llvm_arrays import NotWrittenError
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.loops import looped
from spherejax.compiler.operations import OPERATIONS, TRUTH, Call, NotScalarizable
from spherejax.compiler.program import scalarize

needs_machine_code = pytest.mark.skipif(not machine_code.is_available(), reason="no machine code with this jaxlib")


class Row(NamedTuple):
    """How an operation is tested.

    Attributes:
        function: of floats, in JAX; what it returns may be truths.
        low, high: between which arguments are drawn, and derivatives taken; of all arguments, or of each.
        digits: relative error that is allowed; the libraries of Python, C and XLA differ in the last bits.
        nodes: names of the nodes that it becomes, where that is not the operation alone.
        without: the forms that the operation does not have.
        whole: the function of whole numbers, where a loop may have it.
    """

    function: Callable
    low: float | tuple[float, ...] = -2.0
    high: float | tuple[float, ...] = 2.0
    digits: float = 4e-15
    nodes: set[str] | None = None
    without: Set[str] = frozenset()
    whole: Callable | None = None


def truths(function):
    """Of the signs of floats; a scalar program has no arguments but floats."""
    return lambda *numbers: function(*(x > 0 for x in numbers))


def by_bits(primitive):
    """As JAX orders numbers for searches and sorts: zeros and NaN of either sign are one before."""

    def one(x):
        unsigned = lax.select(x == 0, lax.full_like(x, 0.0), x)
        return lax.select(x != x, lax.full_like(x, np.nan), unsigned)

    return lambda x, y: primitive.bind(one(x), one(y))


def chosen(x, y, z):
    """Of more cases than XLA has as selections, most of which are numbers that are known."""
    cases = [*range(1, 9), y, z, *range(9, 19)]
    return lax.select_n(jnp.floor(10 * x).astype(jnp.int32), *(jnp.broadcast_to(c, x.shape) * 1.0 for c in cases))


ROWS = {
    "add": Row(lambda x, y: x + y, whole=lax.add),
    "sub": Row(lambda x, y: x - y, whole=lax.sub),
    "mul": Row(lambda x, y: x * y, whole=lax.mul),
    "div": Row(lambda x, y: x / y, 0.5, whole=lax.div),
    "neg": Row(lambda x: -x, whole=lax.neg),
    "select": Row(lambda x, y, z: lax.select(x > 0.1, y, z), nodes={"select", "gt"}),
    "lookup": Row(
        chosen,
        (0.805, -2, -2),
        (0.895, 2, 2),
        nodes={"floor", "mul", "integer_of_float", "max", "min", "lookup"},
    ),
    "pow": Row(lambda x, y: x**y, 0.5),
    "sqrt": Row(jnp.sqrt, 0.5),
    "root_guarded_at_zero": Row(lambda x: abs(x) ** 1.5, 0.5, nodes={"abs", "mul", "root_guarded_at_zero"}),
    "rsqrt": Row(lax.rsqrt, 0.5),
    "cbrt": Row(jnp.cbrt, 0.5),
    "square": Row(lax.square, nodes={"mul"}, whole=lax.square),
    "integer_pow": Row(lambda x: lax.integer_pow(x, -3), 0.5, nodes={"mul", "div"}),
    "exp": Row(jnp.exp),
    "exp2": Row(jnp.exp2),
    "expm1": Row(jnp.expm1),
    "log": Row(jnp.log, 0.5),
    "log1p": Row(jnp.log1p, -0.5),
    "logistic": Row(jax.nn.sigmoid),
    "sin": Row(jnp.sin),
    "cos": Row(jnp.cos),
    "tan": Row(jnp.tan, -1.0, 1.0),
    "asin": Row(jnp.asin, -0.8, 0.8),
    "acos": Row(jnp.acos, -0.8, 0.8),
    "atan": Row(jnp.atan),
    "atan2": Row(jnp.atan2, 0.5),
    "sinh": Row(jnp.sinh),
    "cosh": Row(jnp.cosh),
    "tanh": Row(jnp.tanh),
    "asinh": Row(jnp.asinh),
    "acosh": Row(jnp.acosh, 1.2),
    "atanh": Row(jnp.atanh, -0.8, 0.8),
    "erf": Row(lax.erf),
    "erfc": Row(lax.erfc, -1.0, 1.0),
    "abs": Row(jnp.abs, 0.5, whole=jnp.abs),
    "sign": Row(jnp.sign, 0.5, whole=jnp.sign),
    "floor": Row(jnp.floor),
    "ceil": Row(jnp.ceil),
    "round": Row(lambda x: lax.round(x, lax.RoundingMethod.AWAY_FROM_ZERO)),
    "rem": Row(lax.rem, 0.5, whole=lax.rem),
    "nextafter": Row(jnp.nextafter, without={"derivative"}),  # JAX has none
    "is_finite": Row(jnp.isfinite),
    "max": Row(jnp.maximum, whole=jnp.maximum),
    "min": Row(jnp.minimum, whole=jnp.minimum),
    "clamp": Row(lambda low, x, high: lax.clamp(low, x, high), (-2, -2, 0.5), (-0.5, 2, 2), whole=lax.clamp),
    "lt": Row(lax.lt, whole=lax.lt),
    "le": Row(lax.le, whole=lax.le),
    "gt": Row(lax.gt, whole=lax.gt),
    "ge": Row(lax.ge, whole=lax.ge),
    "eq": Row(lax.eq, whole=lax.eq),
    "ne": Row(lax.ne, whole=lax.ne),
    "lt_to": Row(by_bits(lax.lt_to_p), nodes={"le", "not", "eq", "and"}, whole=lax.lt_to_p.bind),
    "le_to": Row(by_bits(lax.le_to_p), nodes={"le", "ne", "or"}, whole=lax.le_to_p.bind),
    "and": Row(truths(lax.bitwise_and), nodes={"gt", "and"}, whole=lax.bitwise_and),
    "or": Row(truths(lax.bitwise_or), nodes={"gt", "or"}, whole=lax.bitwise_or),
    "xor": Row(truths(lax.bitwise_xor), nodes={"gt", "xor"}, whole=lax.bitwise_xor),
    "not": Row(truths(lax.bitwise_not), nodes={"gt", "not"}, whole=lax.bitwise_not),
    "convert_element_type": Row(
        lambda x: (x > 0).astype(float), nodes={"gt", "select"}, whole=lambda n: n.astype(float)
    ),
    # C passes on doubles, which not all whole numbers are; the next row has it.
    "integer_of_float": Row(lambda x: x.astype(int), without={"c"}),
    "float_of_integer": Row(lambda x: x.astype(int).astype(float), nodes={"integer_of_float", "float_of_integer"}),
    "stop_gradient": Row(lax.stop_gradient),
}
BY_THE_COMPILER = {"custom_jvp_node"}
"""Operations that no function of JAX becomes: a node of a function with its own derivative rule (`test_scalarize`)."""

SINCE_JAX_0_11 = {"one_minus_square", "log2", "polynomial"}
"""Of which there are primitives since that version only: see the last test but one."""


def test_every_operation_has_a_row():
    assert ROWS.keys() | BY_THE_COMPILER | SINCE_JAX_0_11 == OPERATIONS.keys()


# Where ---------------------------------------------------------------------------------------------------------------

SPECIAL = [np.nan, -np.inf, -1.5, -0.0, 0.0, 0.3, 1.0, 2.5, np.inf]


@cache
def arguments(name: str) -> tuple[np.ndarray, ...]:
    """All combinations of special numbers, and some by chance."""
    n = n_arguments(name)
    special = np.array([*itertools.product(SPECIAL, repeat=n)]).T
    return tuple(np.concatenate([special, by_chance(name, 7)], 1))


def by_chance(name: str, count: int) -> np.ndarray:
    """Arguments where the operation has a derivative."""
    low, high = (np.reshape(bound, (-1, 1)) for bound in (ROWS[name].low, ROWS[name].high))
    return np.random.default_rng(1).uniform(low, high, (n_arguments(name), count))


@cache
def n_arguments(name: str) -> int:
    """How many floats an operation takes."""
    for n in (1, 2, 3):
        try:
            jax.eval_shape(ROWS[name].function, *[jax.ShapeDtypeStruct((), float)] * n)
        except TypeError:
            continue
        return n
    raise AssertionError(name)


@cache
def expected(name: str) -> np.ndarray:
    return np.asarray(ROWS[name].function(*map(jnp.asarray, arguments(name))))


@cache
def program(name: str):
    """Of one number each."""
    return scalarize(ROWS[name].function, *[jnp.zeros(())] * n_arguments(name))


def agrees(name: str, result, where=slice(None)) -> None:
    result, right = np.asarray(result), expected(name)
    assert result.dtype == right.dtype
    np.testing.assert_allclose(result[where], right[where], rtol=ROWS[name].digits, atol=1e-300)


# In each form --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROWS)
def test_it_becomes_its_node(name):
    assert set(program(name).operations) == (ROWS[name].nodes or {name})


@pytest.mark.parametrize("name", ROWS)
def test_known_numbers_are_folded(name):
    """But for a structural zero, which is of no sign, and whose products are zero."""
    values = arguments(name)
    fixed = {(i, at): x for i, numbers in enumerate(values) for at, x in enumerate(numbers)}
    made = scalarize(ROWS[name].function, *values, fixed=fixed)
    assert made.n_operations == 0
    where = ~np.any([(x == 0) & np.signbit(x) for x in values], 0)
    if name == "mul":
        where &= ~(np.any([x == 0 for x in values], 0) & ~np.all(np.isfinite(values), 0))
    agrees(name, made.compute(*values), where)


@pytest.mark.parametrize("name", ROWS)
def test_python_evaluates_it(name):
    agrees(name, [program(name).compute(*numbers) for numbers in zip(*arguments(name), strict=True)])


@pytest.mark.parametrize("name", ROWS)
def test_jax_evaluates_it_one_by_one(name):
    with jax.disable_jit():
        agrees(name, jax.vmap(program(name))(*arguments(name)))


@pytest.mark.parametrize("name", ROWS)
def test_xla_compiles_it(name):
    agrees(name, jax.jit(jax.vmap(program(name)))(*arguments(name)))


@needs_machine_code
@pytest.mark.parametrize("name", ROWS)
def test_it_is_machine_code_in_lanes(name, monkeypatch):
    monkeypatch.setattr(primitive, "SMALLEST_CALLED", 0)
    made = scalarize(ROWS[name].function, *[jnp.zeros(())] * n_arguments(name))
    with machine_code.native_code():
        compiled = jax.jit(jax.vmap(made)).lower(*arguments(name))
        has_call = "stablehlo.custom_call @spherejax_" in compiled.as_text()
        assert has_call == ("llvm" not in ROWS[name].without)
        agrees(name, compiled.compile()(*arguments(name)))


def in_a_loop(function: Callable, *values: np.ndarray) -> np.ndarray:
    """A function of arrays in a loop that is machine code as a whole; it goes round once."""
    shape = jax.eval_shape(function, *values)

    def run(count, start, *values):
        return lax.while_loop(
            lambda state: state[0] < 1, lambda state: (state[0] + 1, function(*values)), (count, start)
        )

    start = jnp.zeros((), jnp.int64), jnp.zeros(shape.shape, shape.dtype), *map(jnp.asarray, values)
    closed = jax.make_jaxpr(run)(*start)
    (loop,) = closed.jaxpr.eqns
    values_of = dict(zip([*closed.jaxpr.constvars, *closed.jaxpr.invars], [*closed.consts, *start], strict=True))
    operands = [values_of[atom] for atom in loop.invars]
    return np.asarray(jax.jit(lambda *x: looped(loop.params, x))(*operands)[-1])


@needs_machine_code
@pytest.mark.parametrize("name", ROWS)
def test_it_is_machine_code_of_arrays(name):
    """All entries, which are taken eight at a time, and the last ones by fewer."""
    if "llvm" in ROWS[name].without:
        with pytest.raises(NotWrittenError, match=name):
            in_a_loop(ROWS[name].function, *arguments(name))
        return
    agrees(name, in_a_loop(ROWS[name].function, *arguments(name)))


@needs_machine_code
@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.whole])
def test_it_is_machine_code_of_whole_numbers(name):
    n = n_arguments(name)
    values = np.array([*itertools.product([-7, -2, -1, 0, 1, 3, 12], repeat=n)]).T
    function = ROWS[name].whole
    assert function is not None
    np.testing.assert_array_equal(in_a_loop(function, *values), function(*map(jnp.asarray, values)))
    if not OPERATIONS[name].accepts(Call((TRUTH,) * n, TRUTH, {})):
        return
    values = np.array([*itertools.product([False, True], repeat=n)]).T
    np.testing.assert_array_equal(in_a_loop(function, *values), function(*map(jnp.asarray, values)))


@pytest.fixture(scope="module")
def in_c(tmp_path_factory):
    """A function of C for each operation, from a library of all of them."""
    folder = tmp_path_factory.mktemp("c")
    names = [name for name in ROWS if "c" not in ROWS[name].without]
    parts = [PRELUDE]
    for name in names:
        n = n_arguments(name)
        entries = ", ".join(f"a + {i}" for i in range(n))
        parts += [program(name).c_source(f"f_{name}"),
                  f"void test_{name}(const double *a, double *out) {{ double ahead[f_{name}_ahead_size + 1];"
                  f" f_{name}_ahead(a, ahead); f_{name}(ahead, {entries}, out); }}"]  # fmt: skip
    (folder / "all.c").write_text("\n".join(parts))
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None:
        pytest.skip("no compiler of C")
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", "all.c", "-o", "all.so", "-lm"], cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "all.so"))


def test_what_c_does_not_have_is_refused_by_name(monkeypatch):
    monkeypatch.setitem(OPERATIONS, "cbrt", dataclasses.replace(OPERATIONS["cbrt"], c=None))
    with pytest.raises(NotScalarizable, match="'cbrt'"):
        program("cbrt").c_source("f")


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if "c" not in row.without])
def test_c_evaluates_it(name, in_c):
    function, out = getattr(in_c, f"test_{name}"), (ctypes.c_double * 1)()
    results = []
    for numbers in zip(*arguments(name), strict=True):
        function((ctypes.c_double * len(numbers))(*numbers), out)
        results.append(out[0])
    agrees(name, np.array(results).astype(expected(name).dtype))


# Derivatives ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in ROWS if "derivative" not in ROWS[name].without])
def test_its_derivative_is_that_of_finite_differences(name):
    """Forward and back; of JAX's own function where that jumps or has none."""
    if expected(name).dtype != float:
        pytest.skip("of truths there is none")
    function, x = ROWS[name].function, by_chance(name, 6)
    along = np.random.default_rng(2).normal(size=x.shape)
    h = 1e-6
    differences = (function(*(x + h * along)) - function(*(x - h * along))) / (2 * h)
    if name in ("floor", "ceil", "round", "sign", "stop_gradient"):
        right = np.asarray(jax.jvp(function, tuple(x), tuple(along))[1])
    else:
        right = np.asarray(differences)
    made = jax.vmap(program(name))
    forward = jax.jit(lambda x, t: jax.jvp(made, x, t)[1])(tuple(x), tuple(along))
    np.testing.assert_allclose(forward, right, rtol=1e-7, atol=1e-8)
    back = jax.jit(lambda x: jax.vjp(made, *x)[1](jnp.ones(6)))(tuple(x))
    np.testing.assert_allclose(sum(g * t for g, t in zip(back, along, strict=True)), forward, rtol=1e-12, atol=1e-12)


# Primitives that this version of JAX may not have --------------------------------------------------------------------


def primitive_of(name: str, function: Callable) -> Callable:
    """A primitive of a later JAX, as far as the compiler meets it."""
    later = jex.Primitive(name)
    later.def_abstract_eval(lambda x, *_, **__: ShapedArray(x.shape, x.dtype))
    later.def_impl(lambda *arguments, **_: function(*arguments))
    return later.bind


LATER = {
    "one_minus_square": (lambda x: (1 - x) * (1 + x), 1),
    "log2": (np.log2, 1),
    "polynomial": (lambda x, a, b, c: a + x * (b + x * c), 4),
}


@pytest.mark.parametrize("name", sorted(SINCE_JAX_0_11))
def test_primitives_of_a_later_jax(name):
    function, n = LATER[name]
    x = np.random.default_rng(3).uniform(0.5, 2.0, (n, 5))
    made = scalarize(primitive_of(name, function), *x)
    right = function(*x)
    np.testing.assert_allclose(made.compute(*x), right, rtol=1e-14)
    np.testing.assert_allclose(jax.jit(made)(*x), right, rtol=1e-14)
    if machine_code.is_available():
        np.testing.assert_allclose(in_a_loop(primitive_of(name, function), *x), right, rtol=1e-14)


# Where special cases were wrong --------------------------------------------------------------------------------------


def test_whole_numbers_are_divided_as_jax_divides_them():
    """Evaluated at once, 7 / 2 was 3.5 where all else has 3."""
    for divide in (lax.div, lambda a, b: a // b):

        def function(x, divide=divide):
            whole = jnp.where(x > 0, 7, -7)
            return divide(whole, 2), divide(whole, -2), divide(jnp.where(x > 0, 5, 3), whole)

        made = scalarize(function, 0.0)
        for x in (-1.0, 1.0):
            for ours, right in zip(made.compute(x), function(x), strict=True):
                assert ours == right
            for ours, right in zip(made(x), function(x), strict=True):
                assert ours == right


@pytest.mark.parametrize("exponent", [-0.5, -1.5, -1.0, -2.5, 0.5, 2.0, 3.5])
def test_powers_by_known_exponents_where_they_end(exponent):
    """0^(-1/2) was NaN, as 1/0 times 0."""
    x = np.array([0.0, 1e-300, 0.3, 2.0, 1e300, np.inf, np.nan])
    made = scalarize(lambda x: x**exponent, x)
    with np.errstate(all="ignore"):
        right = x**exponent
    for result in (made.compute(x), jax.jit(made)(x)):
        np.testing.assert_allclose(result, right, rtol=1e-14)


@pytest.mark.parametrize("exponent", [np.inf, -np.inf, np.nan, 1e300])
def test_exponents_that_are_no_halves(exponent):
    made = scalarize(lambda x: jnp.power(x, exponent), 0.5)
    np.testing.assert_array_equal(made.compute(0.5), np.power(0.5, exponent))


@pytest.mark.parametrize("how", ["and", "or", "max", "min", "sum", "prod"])
def test_whole_numbers_are_put_together(how):
    """Of bits, `and` began with 1 and not with all of them."""
    reduced = getattr(lax, f"reduce_{how}_p").bind
    parameters = {"axes": (0,)} | ({"out_sharding": None} if how in ("sum", "max", "min", "prod") else {})

    def function(x):
        return reduced(jnp.where(x > 0, jnp.array([6, 14, -2]), 7), **parameters)

    try:
        jax.eval_shape(function, 0.0)
    except TypeError:
        parameters.pop("out_sharding")
    made = scalarize(function, 0.0)
    for x in (1.0, -1.0):
        assert made.compute(x) == function(x)
        assert in_a_loop(function, np.asarray(x)) == function(x)


WRAPPING: dict[str, Callable] = {
    "sums": lambda k: k + k,
    "differences": lambda k: -k - k,
    "products": lambda k: k * k,
    "powers": lambda k: k**3,
    "of another type": lambda k: (-k).astype(jnp.uint8 if k.dtype == jnp.int8 else jnp.int8),
}


@pytest.mark.parametrize("name", WRAPPING)
@pytest.mark.parametrize("dtype", [jnp.int8, jnp.uint8, jnp.int32, jnp.uint32])
def test_whole_numbers_of_fewer_bits_wrap_around(name, dtype, monkeypatch):
    """They are computed with 64 bits, and were then beyond what their type has, in silence."""
    monkeypatch.setattr(primitive, "SMALLEST_CALLED", 0)
    large = int(jnp.iinfo(dtype).max) // 2 + 7

    def of_constant(x):
        return WRAPPING[name](jnp.asarray(large, dtype)) + 0 * x

    def of_computed(x):
        return WRAPPING[name](jnp.where(x > 0, jnp.asarray(large, dtype), jnp.asarray(1, dtype))) * 1.0

    for function in (of_constant, of_computed):
        made, x = scalarize(function, 0.7), np.array([0.7, -0.3])
        right = jax.vmap(function)(x)
        np.testing.assert_array_equal([made.compute(one) for one in x], right)
        np.testing.assert_array_equal(jax.jit(jax.vmap(made))(x), right)
        with machine_code.native_code():
            np.testing.assert_array_equal(jax.jit(jax.vmap(made)).lower(x).compile()(x), right)


BOUNDED: dict[str, Callable] = {
    "a branch": lambda x: jax.lax.cond(x > 0, lambda x: 2 * x, lambda x: -x, x),
    "a count": lambda x: jnp.where(jnp.sum((x > jnp.arange(5.0)).astype(jnp.int32)) < 2, x, -x),
    "chosen and limited": lambda x: jnp.where(jnp.minimum(jnp.where(x > 0, jnp.int32(7), -3) * 2, 10) > 5, x, -x),
    "with its sign changed": lambda x: jnp.where(-jnp.where(x > 0, jnp.int32(7), -3) > 2, x, 3 * x),
}


@pytest.mark.parametrize("name", BOUNDED)
def test_whole_numbers_that_surely_stay_in_their_range_are_scalars(name):
    """A law with `jax.lax.cond` has one for its index."""
    program = scalarize(BOUNDED[name], jnp.array(0.7))
    for x in (-0.7, 0.3, 1.2, 3.4):
        assert float(program.compute(np.asarray(x))) == pytest.approx(float(BOUNDED[name](jnp.array(x))), rel=1e-14)


def test_a_number_beyond_64_bits_may_be_any():
    """Its limits say nothing: it wraps around."""

    def function(x):
        k = jnp.where(x > 0, jnp.asarray(2**62, jnp.int64), 1)
        return jnp.minimum(4 * k, 5).astype(jnp.int32) * x

    made = scalarize(function, jnp.array(0.7))
    for x in (-0.7, 0.7):
        assert made.compute(x) == function(jnp.array(x))


LIMITED: dict[str, Callable] = {
    "chosen": lambda k, n: jnp.where(k > 0, k, n),
    "added": lambda k, n: k + 3 * n - k * n,
    "divided": lambda k, n: lax.div(k, n),
    "the rest": lambda k, n: lax.rem(k, n),
    "by a number": lambda k, n: lax.div(k, jnp.asarray(-3)) + lax.rem(n, jnp.asarray(4)) + lax.div(n, jnp.asarray(2)),
    "without sign": lambda k, n: jnp.abs(k) - jnp.sign(n) + -k,
    "bits": lambda k, n: (k & 6) + (jnp.abs(k) & n),
    "bounded": lambda k, n: jnp.maximum(jnp.minimum(k, n), -2) + lax.clamp(jnp.asarray(-1), n, jnp.asarray(3)),
    "looked up": lambda k, n: jnp.array([4, -7, 9, 2, 30])[jnp.clip(k, 0, 4)] * n,
}


@pytest.mark.parametrize("name", LIMITED)
def test_whole_numbers_are_within_their_limits(name):
    """Of each operation that says between what its results are, all that it gives for arguments within limits."""

    def function(x, y):
        k, n = (jnp.clip(z.astype(int), -5, 6) for z in (x, y))
        return LIMITED[name](k, n)

    made = scalarize(function, 0.0, 0.0)
    (node,) = made._flat_outputs
    low, high = made._graph.limits(node)
    assert low > -1000
    assert high < 1000
    x, y = (a.ravel() * 1.0 for a in np.meshgrid(np.arange(-6, 8), np.arange(-6, 8)))
    values = jax.vmap(function)(x, y)
    assert low <= values.min()
    assert values.max() <= high
    np.testing.assert_array_equal(jax.jit(jax.vmap(made))(x, y), values)
