"""Long sums of products as loops over vectors: the numbers of the function, whatever stands side by side or not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import native_code, scalarize
from spherejax.compiler.emit import llvm_sums
from spherejax.compiler.emit.llvm import FunctionText
from spherejax.compiler.emit.llvm_sums import FEWEST_DOTS, SHORTEST, columns_ahead


@pytest.fixture(autouse=True)
def on(monkeypatch):
    """In lines of any size."""
    monkeypatch.setattr(llvm_sums, "FEWEST", 0)
    with native_code():
        if not native_code.is_enabled():
            pytest.skip("no machine code with this jaxlib, or without llvmlite")
        yield


def numbers(*shape, seed=0):
    return jnp.asarray(np.random.default_rng(seed).uniform(-1.0, 1.0, shape))


def kinds_of(line):
    """Which of the four shapes are called in the text of a line, and the text."""
    text = FunctionText(line, (), (0,) * (len(line.shapes) + len(line.residuals))).written()
    # Behind the functions that are called, of which one calls another.
    calls = [one for one in text[text.rindex("define ") :].splitlines() if "call " in one]
    return {kind for kind in ("dot", "dots", "columns", "row") if any(f" @spherejax.{kind}(" in c for c in calls)}, text


def assert_same_numbers(function, *examples, rtol=1e-13):
    """Value, forward and reverse derivatives, of the program and of the function."""
    program = scalarize(function, *examples)
    tangents = tuple(jnp.cos(7.0 * x + 1.0) for x in examples)
    expected, slopes = jax.jvp(function, examples, tangents)
    cotangent = jnp.sin(3.0 * expected + 1.0)
    back = jax.vjp(function, *examples)[1](cotangent)
    size = jax.tree.map(lambda x: 1e-15 + rtol * jnp.max(jnp.abs(x)), (expected, slopes, back))
    results = (
        jax.jit(program)(*examples),
        jax.jit(lambda *x: jax.jvp(program, x, tangents)[1])(*examples),
        jax.jit(lambda *x: jax.vjp(program, *x)[1](cotangent))(*examples),
    )
    jax.tree.map(
        lambda a, b, s: np.testing.assert_allclose(a, b, rtol=0, atol=s), results, (expected, slopes, back), size
    )
    return program


@pytest.mark.parametrize(
    ("n", "m"), [(16, 16), (17, 35), (64, 41), (8, 47), (3, 100), (100, 3), (1, 33), (33, 1), (15, 15)]
)
def test_a_matrix_times_a_vector(n, m):
    program = assert_same_numbers(lambda w, x: jnp.sin(w @ x), numbers(n, m), numbers(m, seed=1))
    line = program.line_called()
    derivative = line.derivative((True, True), reads_arguments=True)
    back = derivative.slopes.transposed((True, True, *(False for _ in derivative.slopes.shapes[2:]), False), (True,))
    of_rows = set() if m < SHORTEST else {"dots"} if n >= FEWEST_DOTS else {"dot"}
    assert [kinds_of(one)[0] for one in (line, derivative.slopes)] == [of_rows, of_rows]
    of_sums = set() if n < SHORTEST else {"dot"} if m == 1 else {"columns"} if m >= SHORTEST else set()
    assert kinds_of(back)[0] == of_sums | ({"row"} if m >= SHORTEST or (m == 1 and n >= SHORTEST) else set())


@pytest.mark.parametrize("entry", range(9))
@pytest.mark.parametrize(("n", "m"), [(16, 16), (19, 24), (24, 40), (9, 64), (17, 19)])
def test_a_matrix_that_begins_anywhere_in_a_cache_line(entry, n, m):
    """What stands around it in its array is not part of any sum."""
    flat = numbers(entry + n * m + 9).at[:entry].set(jnp.nan).at[entry + n * m :].set(jnp.nan)

    def function(flat, x):
        return flat[entry : entry + n * m].reshape(n, m) @ x

    program, x = scalarize(function, flat, numbers(m)), numbers(m, seed=1)
    np.testing.assert_allclose(jax.jit(program)(flat, x), function(flat, x), rtol=0, atol=1e-14 * m)
    cotangent = numbers(n, seed=2)
    back = jax.jit(lambda x: jax.vjp(lambda x: program(flat, x), x)[1](cotangent)[0])(x)
    np.testing.assert_allclose(back, cotangent @ flat[entry : entry + n * m].reshape(n, m), rtol=0, atol=1e-14 * n)


def test_columns_ahead_of_a_cache_line():
    assert [columns_ahead(entry, 16, 16) for entry in (0, 1, 7, 8, 12)] == [0, 7, 1, 0, 4]
    assert columns_ahead(1, 17, 17) == 0  # each row begins elsewhere in its line
    assert columns_ahead(1, 8, 8) == 0  # no whole vector would be left


def test_the_text_grows_with_the_rows_of_a_matrix_and_not_with_its_columns():
    def lines(n):
        program = scalarize(lambda w, x: w @ x, numbers(n, n), numbers(n))
        return kinds_of(program.line_called())[1].count("\n")

    assert lines(48) - lines(32) == 16 * (lines(17) - lines(16))
    assert lines(17) - lines(16) < 12  # of each row a few lines


@pytest.mark.parametrize("widths", [(2, 32, 32, 1), (3, 20, 17, 5), (20, 16, 40, 16)])
def test_a_network(widths):
    shapes = [*zip(widths[1:], widths, strict=False)]
    sizes = np.cumsum([0, *(n * m + n for n, m in shapes)])

    def network(flat, x):
        for (n, m), begin, end in zip(shapes, sizes, sizes[1:], strict=False):
            x = jnp.tanh(flat[begin : end - n].reshape(n, m) @ x + flat[end - n : end])
        return x

    assert_same_numbers(network, 0.3 * numbers(int(sizes[-1])), numbers(widths[0], seed=1))


PRODUCTS = {
    "the transposed matrix": lambda w, x: w.T @ x,
    "both factors arguments": lambda w, x: x @ (w @ x),
    "one matrix twice": lambda w, x: w @ jnp.sin(w @ x),
    "squares": lambda w, x: jnp.sum(w * w, axis=1) * x,
    "sums that are read again": lambda w, x: (w @ x) * jnp.roll(w @ x, 1) + w @ x,
    "products that are read again": lambda w, x: (w[1] * x) * jnp.sum(w[1] * x),
    "every second entry": lambda w, x: w[:, ::2] @ x[::2],
    "backwards": lambda w, x: w[:, ::-1] @ x,
    "a part of the matrix": lambda w, x: w[3:25, 5:26] @ jnp.cos(x[5:26]),
    "differences": lambda w, x: w @ x - w.T @ x,
    "a polynomial": lambda w, x: w[0] @ jnp.stack([x[0] ** k for k in range(30)]) + 0 * x,
    "a multiple of an argument": lambda w, x: jnp.exp(x[0]) * w[2],
    "constants": lambda w, x: jnp.asarray(np.linspace(0.0, 1.0, 900).reshape(30, 30)) @ x * w[0, 0],
    "a symmetric matrix": lambda w, x: (w + w.T) @ x,
    "one row for all": lambda w, x: jnp.outer(w[0], x)[:, 4] + w[4] * x,
}


@pytest.mark.parametrize("name", PRODUCTS)
def test_other_sums(name):
    assert_same_numbers(PRODUCTS[name], numbers(30, 30), numbers(30, seed=1))


@pytest.mark.parametrize("seed", range(6))
def test_any_sums(seed):
    """Sums of products of any entries, in any order, some read by several."""

    def function(w, x):
        random = np.random.default_rng(seed)  # anew each time it is traced
        values = [*jnp.sin(x), *x]
        for _ in range(15):
            begin, step, n = random.integers(300), random.integers(1, 4), random.integers(2, 40)
            entries = (begin + step * np.arange(n)) % 400
            if random.random() < 0.3:
                random.shuffle(entries)
            places = random.integers(len(values), size=n) if random.random() < 0.5 else np.arange(n)
            total = values[random.integers(len(values))] if random.random() < 0.5 else 0.0
            for entry, place in zip(entries, places, strict=True):
                total = total + w[entry] * values[place]
            values.append(jnp.sin(total))
        return jnp.stack(values[-25:] + [w[3] * value for value in values[:22]])

    assert_same_numbers(function, numbers(400, seed=seed), numbers(20, seed=1 + seed), rtol=1e-10)
