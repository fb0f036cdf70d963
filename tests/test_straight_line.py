"""A scalar program as one operation: the same numbers as its operations one by one, under every transformation."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import primitive
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.program import scalarize
from spherejax.program_cache.fingerprints import program_fingerprint


@pytest.fixture(autouse=True, params=["by XLA", "machine code"])
def made(request, monkeypatch):
    """Every test twice: what XLA compiles, and what is machine code of its own, however small."""
    monkeypatch.setattr(primitive, "SMALLEST_CALLED", 0)
    with machine_code.native_code(request.param == "machine code"):
        if request.param == "machine code" and not machine_code.native_code_enabled():
            pytest.skip("no machine code with this jaxlib, or without llvmlite")
        yield request.param


def everything(numbers, t, y):
    """Operations written by ourselves and by JAX, selections, constants, entries twice, nothing, and what is known."""
    bent = jnp.where(y > t, jnp.abs(y) ** 1.5 + numbers[0], jnp.maximum(y, -0.5) * numbers[1])
    ahead = jnp.tanh(numbers) / (1 + numbers**2)
    return {
        "bent": bent,
        "twice": jnp.stack([y, y[::-1]]) * ahead[0],
        "one": jnp.exp(-t) + jnp.sum(jnp.sin(y) * jnp.arctan2(y, numbers[0])),
        "known": jnp.array([1.0, 2.0]),
        "nothing": jnp.zeros((0, 3)),
        "ahead": ahead,
        "signs": (y >= 0) & ~(y == 1.0) | (y != y),
    }


NUMBERS, T, Y = jnp.array([0.7, -0.3]), jnp.array(0.2), jnp.array([0.9, -1.1, 0.15])
PROGRAM = scalarize(everything, NUMBERS, T, Y)
FLOATS = ("bent", "twice", "one", "known", "ahead")


def same(found, expected, **tolerance):
    jax.tree.map(
        lambda a, b: np.testing.assert_allclose(a, b, **{"rtol": 1e-14, "atol": 1e-15, **tolerance}), found, expected
    )


def inside(numbers, t, y):
    return PROGRAM.inside(PROGRAM.ahead(numbers), numbers, t, y)


@pytest.mark.parametrize("program", [PROGRAM, inside])
def test_numbers(program):
    same(program(NUMBERS, T, Y), everything(NUMBERS, T, Y))
    same(jax.jit(program)(NUMBERS, T, Y), everything(NUMBERS, T, Y))
    with jax.disable_jit():
        same(program(NUMBERS, T, Y), everything(NUMBERS, T, Y))


AXES = [axes for axes in itertools.product((None, 0, -1), (None, 0), (None, 0, -1)) if any(a is not None for a in axes)]


@pytest.mark.parametrize("axes", AXES)
def test_lanes(axes):
    """On any axis of any argument, and what does not differ between lanes has none."""
    spread = jnp.array([1.0, 0.4, -2.0, 1.3])
    arguments = [
        x if axis is None else jnp.moveaxis(jnp.multiply.outer(spread, x), 0, axis)
        for x, axis in zip((NUMBERS, T, Y), axes, strict=True)
    ]
    same(jax.vmap(inside, axes)(*arguments), jax.vmap(everything, axes)(*arguments))
    same(jax.vmap(PROGRAM, axes, -1)(*arguments), jax.vmap(everything, axes, -1)(*arguments))


def test_lanes_within_lanes():
    ys = jnp.stack([Y, 2 * Y])
    numbers = jnp.stack([NUMBERS, -NUMBERS, 0.5 * NUMBERS])
    for function in (PROGRAM, inside):
        both = jax.vmap(jax.vmap(function, (None, None, 0)), (0, None, None))
        crossed = jax.vmap(jax.vmap(function, (0, None, 0), -1), (None, 0, -1))
        wants = [jax.vmap(jax.vmap(everything, (None, None, 0)), (0, None, None))(numbers, T, ys)]
        wants.append(
            jax.vmap(jax.vmap(everything, (0, None, 0), -1), (None, 0, -1))(
                numbers, jnp.arange(3.0), jnp.zeros((3, 3, 3)) + Y
            )
        )
        same(both(numbers, T, ys), wants[0])
        same(crossed(numbers, jnp.arange(3.0), jnp.zeros((3, 3, 3)) + Y), wants[1])


def floats(function):
    return lambda *arguments: {name: function(*arguments)[name] for name in FLOATS}


def total(function):
    return lambda *arguments: sum(jnp.sum(x * x) for x in jax.tree.leaves(floats(function)(*arguments)))


@pytest.mark.parametrize("program", [PROGRAM, inside])
def test_derivatives(program):
    along = (0.3 * NUMBERS, jnp.array(1.0), jnp.cos(Y))
    same(jax.jvp(floats(program), (NUMBERS, T, Y), along), jax.jvp(floats(everything), (NUMBERS, T, Y), along))
    for by in (0, 1, 2):
        for mode in (jax.jacfwd, jax.jacrev):
            same(mode(floats(program), by)(NUMBERS, T, Y), mode(floats(everything), by)(NUMBERS, T, Y))
    same(jax.hessian(total(program), 2)(NUMBERS, T, Y), jax.hessian(total(everything), 2)(NUMBERS, T, Y), rtol=1e-12)


def test_derivatives_of_lanes_and_lanes_of_derivatives():
    ys = jnp.stack([Y, 2 * Y, -Y])

    def of_lanes(function):
        return jax.grad(lambda n, ys: jnp.sum(jax.vmap(lambda y: total(function)(n, T, y))(ys)), (0, 1))(NUMBERS, ys)

    def lanes_of(function):
        return jax.vmap(jax.grad(total(function), (0, 2)), (None, None, 0))(NUMBERS, T, ys)

    for function in (PROGRAM, inside):
        same(of_lanes(function), of_lanes(everything), rtol=1e-12)
        same(lanes_of(function), lanes_of(everything), rtol=1e-12)


ONE = {
    name: getattr(jnp, name)
    for name in ("exp", "log", "log1p", "expm1", "tanh", "tan", "arcsin", "arctan", "sinh", "sqrt", "abs", "cbrt")
} | {
    "erf": jax.scipy.special.erf,
    "logistic": jax.nn.sigmoid,
    "to the three halves": lambda x: jnp.where(x > 0, jnp.maximum(x, 0.0) ** 1.5, 0.0),
    "square": lambda x: x * x,
    "held fast": lambda x: x * jax.lax.stop_gradient(x),
    "steps": lambda x: x * jnp.floor(4 * x),
    "between": lambda x: jnp.clip(x, 0.2, 0.5),
    "product with itself": lambda x: (x + 1) * (x + 1),
}
TWO = {
    "pow": lambda x, y: x**y,
    "arctan2": jnp.arctan2,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "div": lambda x, y: x / y,
    "remainder": jnp.remainder,
    "selected": lambda x, y: jnp.where(x > y, x * y, y / x),
    "nothing of it": lambda x, y: x * 0 + y,
}


@pytest.mark.parametrize("name", ONE)
def test_every_function_has_the_derivatives_that_jax_takes(name):
    """Twice, forward and back; at the corner of a range as well."""
    made = scalarize(ONE[name], jnp.asarray(0.3))
    for point in map(jnp.asarray, (0.3, 0.2)):
        for mode in (jax.jvp, lambda f, x, along: jax.vjp(f, *x)[1](along[0])):
            same(*(mode(f, (point,), (jnp.asarray(1.3),)) for f in (made, ONE[name])))
        same(*(jax.hessian(f)(point) for f in (made, ONE[name])), rtol=1e-12)


@pytest.mark.parametrize("name", TWO)
def test_every_function_of_two_has_the_derivatives_that_jax_takes(name):
    """By each and by both, and where the two are equal."""
    made = scalarize(TWO[name], jnp.asarray(0.4), jnp.asarray(0.9))
    for point in ((jnp.asarray(0.4), jnp.asarray(y)) for y in (0.4, 0.9)):
        for by in (0, 1, (0, 1)):
            same(*(jax.jacfwd(f, by)(*point) for f in (made, TWO[name])))
            same(*(jax.jacrev(f, by)(*point) for f in (made, TWO[name])))
        same(*(jax.hessian(f, (0, 1))(*point) for f in (made, TWO[name])), rtol=1e-12)


def test_a_root_is_flat_where_it_is_guarded():
    """x sqrt(x) has the derivative 0 at 0, where its factors have 0 and infinity."""
    made = scalarize(lambda x: jnp.maximum(x, 0.0) ** 1.5, jnp.asarray(0.0))
    assert jax.jvp(made, (jnp.zeros(()),), (jnp.ones(()),))[1] == 0
    assert jax.grad(made)(jnp.zeros(())) == 0


def test_derivatives_cost_what_they_must():
    """Coefficients are made once, whatever the number of tangents; what does not move costs nothing."""
    line = PROGRAM._line("rest")
    derivative = line.derivative((False, False, True, *(False for _ in line.residuals)))
    value = line.graph.count(line._flat, line.flat_residuals).total()
    slopes = derivative.slopes.graph.count(derivative.slopes._flat, derivative.slopes.flat_residuals).total()
    assert 0 < slopes < 3 * value
    names = derivative.slopes.graph.count(derivative.slopes._flat, derivative.slopes.flat_residuals)
    assert set(names) <= {"add", "sub", "mul", "neg", "select"}
    by_time = line.derivative((False, True, False, *(False for _ in line.residuals)))
    names = sorted(everything(NUMBERS, T, Y))
    assert [name for name, follows in zip(names, by_time.follows, strict=True) if follows] == ["one"]


def test_coefficients_that_are_arguments_are_read_from_them(made):
    """Those of a product of a matrix with a vector are its numbers: in machine code nothing is copied."""

    def product(numbers, x):
        return jnp.sin(numbers.reshape(12, 12) @ x)

    numbers, x = jnp.linspace(-1.0, 1.0, 144), jnp.linspace(0.2, 0.7, 12)
    tangents = jnp.cos(numbers), jnp.sin(9.0 * x)
    program = scalarize(product, numbers, x)
    if made == "machine code":
        line = program.line_called()
        copied, read = (line.derivative((True, True), reads) for reads in (False, True))
        assert [copied.read, read.read, line.derivative((False, True), True).read] == [(), (0, 1), (0,)]
        n_values = [sum(output.size for output in each.values.outputs) for each in (copied, read)]
        assert n_values == [12 + 12 + 144 + 12, 12 + 12]  # the results, and slopes of the sine
    same(jax.jvp(program, (numbers, x), tangents)[1], jax.jvp(product, (numbers, x), tangents)[1])
    same(jax.vjp(program, numbers, x)[1](x), jax.vjp(product, numbers, x)[1](x))
    many = jnp.stack([x, -x, 2.0 * x])
    gradients = (jax.grad(lambda n, y, of=of: jnp.sum(of(n, y) ** 2), (0, 1)) for of in (program, product))
    same(*(jax.vmap(of_one, (None, 0))(numbers, many) for of_one in gradients), rtol=1e-12)


@pytest.mark.parametrize("moving", [(0,), (1,), (0, 1)])
def test_of_an_argument_some_entries_may_move(moving):
    """What the others would add costs nothing, ahead of a loop and inside it."""
    ahead = PROGRAM.ahead(NUMBERS)
    line, given = PROGRAM.line_inside(ahead)
    moves = PROGRAM.moving_inside(ahead, frozenset(moving))
    derivative, whole = (line.derivative((some[0], False, True, *some[1:])) for some in (moves, (True,) * len(moves)))
    along = jnp.zeros(2).at[jnp.array(moving)].set(1.3), jnp.array([0.2, -0.7, 0.4])
    slopes = jax.jvp(PROGRAM.ahead, (NUMBERS,), along[:1])[1]
    _, slopes = PROGRAM.line_inside(slopes)
    picked = [along[0][jnp.array(moving)], along[1]]
    picked += [jnp.atleast_1d(x)[jnp.array(some)] for x, some in zip(slopes, moves[1:], strict=True) if some]
    found = derivative.values(NUMBERS, T, Y, *given)
    changes = derivative.slopes(*picked, *found[len(line.outputs) :])
    _, expected = jax.jvp(lambda numbers, y: everything(numbers, T, y), (NUMBERS, Y), along)
    names = itertools.compress(sorted(expected), derivative.follows)
    same(changes, [expected[name] for name in names])
    n = derivative.slopes.n_operations
    assert n < whole.slopes.n_operations if len(moving) == 1 else n == whole.slopes.n_operations


@pytest.mark.parametrize("width", [1, 2])
def test_one_lane_needs_no_axis(width):
    program = jax.make_jaxpr(jax.vmap(PROGRAM, (None, None, 0)))(NUMBERS, T, jnp.stack([Y] * width))
    (line,) = (e for e in program.eqns if e.primitive.name == "straight_line")
    assert len(line.params["lanes"]) == (width > 1)
    ys = jnp.stack([Y] * width)
    same(jax.vmap(PROGRAM, (None, None, 0))(NUMBERS, T, ys), jax.vmap(everything, (None, None, 0))(NUMBERS, T, ys))


def test_linear_programs_are_transposed():
    """In lanes too; what does not depend on the linear argument is left alone."""

    def product(numbers, t, y):
        return {"linear": jnp.stack([numbers[0] * y[0] + t * y[2], numbers[1] * y[1]]), "other": numbers * t}

    made = scalarize(product, NUMBERS, T, Y)
    along = {"linear": jnp.array([0.3, -2.0])}

    def back(function, y, t, along):
        only = lambda y: {"linear": function(NUMBERS, t, y)["linear"]}  # noqa: E731
        return jax.linear_transpose(only, y)(along)

    same(back(made, Y, T, along), back(product, Y, T, along))
    times, alongs = jnp.array([0.1, 0.7]), {"linear": jnp.array([[1.0, 2.0], [0.5, -1.0]])}
    same(*(jax.vmap(lambda t, a, f=f: back(f, Y, t, a))(times, alongs) for f in (made, product)))

    def in_lanes(function):
        return lambda y: jax.vmap(lambda t: function(NUMBERS, t, y)["linear"])(times)

    same(*(jax.linear_transpose(in_lanes(f), Y)(alongs["linear"]) for f in (made, product)))


def arithmetic(jaxpr) -> set[str]:
    names = set()
    for equation in jaxpr.eqns:
        names.add(equation.primitive.name)
        for value in equation.params.values():
            if hasattr(value, "jaxpr"):
                names |= arithmetic(value.jaxpr)
    return names & {"mul", "add", "sub", "tanh", "sin", "neg", "div", "straight_line"}


def test_what_does_not_move_has_no_derivative_in_the_program():
    """As of an operation of JAX: nothing is computed for outputs that do not depend on what moves."""

    def linear(name):
        _, along = jax.linearize(lambda n: PROGRAM(n, T, Y)[name], NUMBERS)
        return arithmetic(jax.make_jaxpr(along)(NUMBERS))

    assert not linear("known")
    assert linear("ahead") == {"straight_line"}  # the check can fail


def test_one_operation_in_the_program_and_its_words():
    program = jax.make_jaxpr(jax.vmap(PROGRAM, (None, None, 0)))(NUMBERS, T, jnp.stack([Y, Y]))
    assert [e.primitive.name for e in program.eqns].count("straight_line") == 1
    assert arithmetic(program.jaxpr) == {"straight_line"}
    assert "tanh 2" in str(program)


def test_programs_in_programs():
    outer = scalarize(lambda n, t, y: PROGRAM(n, t, 2 * y)["twice"], NUMBERS, T, Y)
    same(outer(NUMBERS, T, Y), everything(NUMBERS, T, 2 * Y)["twice"])
    mapped = scalarize(
        lambda n, t, y: jax.vmap(PROGRAM, (None, 0, None))(n, jnp.stack([t, 2 * t]), y)["bent"], NUMBERS, T, Y
    )
    same(mapped(NUMBERS, T, Y), jax.vmap(everything, (None, 0, None))(NUMBERS, jnp.stack([T, 2 * T]), Y)["bent"])


def test_fingerprints_tell_programs_apart():
    def told(function):
        made = scalarize(function, NUMBERS, T, Y)
        return program_fingerprint(made, NUMBERS, T, Y).fingerprint

    assert told(lambda n, t, y: y * n[0] + t) == told(lambda n, t, y: y * n[0] + t)
    others = [
        told(f) for f in (lambda n, t, y: y * n[1] + t, lambda n, t, y: y * n[0] - t, lambda n, t, y: 2 * y * n[0] + t)
    ]
    assert len({*others, told(lambda n, t, y: y * n[0] + t)}) == 4


def test_one_by_one_is_what_it_says():
    names = {
        e.primitive.name
        for e in jax.make_jaxpr(PROGRAM._line("whole").one_by_one((), (0,) * 3))(NUMBERS, T, Y)
        .jaxpr.eqns[0]
        .params["jaxpr"]
        .eqns
    }
    assert {"add", "mul", "tanh"} <= names


@jax.custom_jvp
def doubled(x):
    return x + x


@doubled.defjvp
def doubled_jvp(primals, tangents):
    return doubled(*primals), doubled(*tangents)


@jax.custom_jvp
def bent(x):
    return jnp.sin(2 * x)


@bent.defjvp
def bent_jvp(primals, tangents):
    """With a function in it that has a rule itself."""
    return bent(*primals), doubled(jnp.cos(2 * primals[0]) * tangents[0])


def test_rules_within_rules_are_transposed():
    program = scalarize(lambda y: bent(y) * y[0], Y)
    weights = jnp.array([0.3, -1.2, 2.0])[: Y.size]

    def slope(function, y):
        return jax.grad(lambda y: weights @ function(y))(y)

    np.testing.assert_allclose(slope(program, Y), slope(lambda y: bent(y) * y[0], Y), rtol=1e-14)
    for second in (jax.hessian, lambda f: lambda y: jax.grad(lambda y: weights @ jax.grad(f)(y))(y)):
        found, expected = (second(lambda y, f=f: weights @ f(y))(Y) for f in (program, lambda y: bent(y) * y[0]))
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)
