"""Array code as one function of machine code gives what the array code gives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import ArrayProgram, native_code
from spherejax.compiler.emit.llvm_arena import shared_room
from spherejax.compiler.emit.llvm_arrays import NotWrittenError
from spherejax.compiler.linear_algebra import BlockPattern, block_solve, mapped, rows_at
from spherejax.compiler.native import loops

pytestmark = pytest.mark.skipif(not native_code.is_available(), reason="no machine code with this jaxlib")

RNG = np.random.default_rng(0)
X, Y, V = RNG.standard_normal((40, 3)), RNG.standard_normal((40, 3)), RNG.standard_normal(40)
M = RNG.standard_normal((40, 3, 3))


def both(function, *arguments):
    """What a function gives as machine code, and as array code."""
    examples = [jax.ShapeDtypeStruct(np.shape(x), jnp.result_type(x)) for x in arguments]
    program = ArrayProgram.of(lambda *x: [function(*x)], *examples)
    assert program.can_be_called
    return jax.jit(lambda *x: program(*x)[0])(*arguments), jax.jit(function)(*arguments)


def mapped_over(function, *arguments):
    return mapped(function, (0,) * len(arguments), arguments)


PLACES = np.array([3, 3, 0, 39, 7])
CASES = {
    "entry by entry": (lambda x, y: jnp.sin(x) * y + 2.0, X, Y),
    "spread": (lambda x, v: x * v[:, None] + jnp.arange(3.0), X, V),
    "moves behind moves": (lambda x, y: jnp.concatenate([x.T[1:], y.T], 0)[::-1].reshape(-1, 8), X, Y),
    "taken rows": (lambda x: rows_at(x, PLACES) - x[5], X),
    "padded": (lambda x: jnp.pad(x, ((1, 0), (0, 2)), constant_values=0.5), X),
    "a constant among arrays": (lambda x: jnp.concatenate([x, jnp.asarray(Y[:5])]) @ jnp.eye(3), X),
    "sums": (lambda x: jnp.concatenate([jnp.sum(x, 0), jnp.sum(x, 1), jnp.sum(x)[None]]), X),
    "the largest": (lambda x: jnp.max(x, 1) - jnp.min(x), X),
    "product of matrices": (lambda m, x: m @ x[:, :, None], M, X),
    "one large product": (lambda x, y: x @ y.T, X, Y),
    "a number alone": (lambda v: v[3] * v + jnp.where(v[0] > 0, v, -v), V),
    "truths": (lambda v, x: jnp.where(v[:, None] > 0, x, 0.0), V, X),
    "mapped": (lambda m, x: mapped_over(lambda m, x: m @ x / (1 + x @ x), m, x), M, X),
    "a loop": (lambda x: jax.lax.fori_loop(0, 3, lambda i, y: y * 0.5 + x.T[i][:, None], x), X),
    "a branch": (lambda x: jax.lax.cond(x[0, 0] > 0, lambda: x.T, lambda: -x.T), X),
    "nothing moved": (lambda x: x, X),
}


@pytest.mark.parametrize("name", CASES)
def test_operations(name):
    found, expected = both(*CASES[name])
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14)


def test_what_is_mapped_is_one_scalar_program_whatever_the_number_of_things():
    def function(m, x):
        return mapped_over(lambda m, x: m @ x / (1 + x @ x), m, x)

    texts = []
    for n in (40, 400):
        shapes = [jax.ShapeDtypeStruct((n, *x.shape[1:]), x.dtype) for x in (M, X)]
        program = ArrayProgram.of(lambda *x: [function(*x)], *shapes)
        names = [equation.primitive.name for equation in program.jaxpr.eqns]
        assert names.count("straight_line") == 1
        lines = program.written()[0].splitlines()
        texts.append(len([line for line in lines if "private constant" not in line]))
    assert texts[0] == texts[1]


def test_a_function_that_closes_over_traced_values_is_mapped_as_array_code():
    found, expected = both(lambda x, v: mapped_over(lambda x: x * v[0], x), X, V)
    np.testing.assert_allclose(found, expected, rtol=1e-15)


def test_a_long_loop_around_array_code_is_left_to_xla(monkeypatch, caplog):
    program = ArrayProgram.of(lambda x: [jnp.sin(x) * 0.5 + x[::-1]], jax.ShapeDtypeStruct((40,), float))

    def turned():
        return jax.lax.fori_loop(0, 5, lambda _, x: jnp.cos(program(x)[0]), jnp.asarray(V))

    def results():
        with caplog.at_level("INFO", "spherejax.compiler"):
            caplog.clear()
            found = jax.jit(lambda: native_code(True)(turned)())()
        return found, [record.message for record in caplog.records]

    whole, said = results()
    assert not said
    monkeypatch.setattr(loops, "LARGEST_AROUND_ARRAYS", 5)
    by_xla, said = results()
    assert said == ["a loop of a run is left to XLA: a long loop around array code"]
    expected = V
    for _ in range(5):
        expected = np.cos(np.sin(expected) * 0.5 + expected[::-1])
    for found in (whole, by_xla):
        np.testing.assert_allclose(found, expected, rtol=1e-13)


def test_outside_of_machine_code_nothing_changes():
    names = [e.primitive.name for e in jax.make_jaxpr(lambda x: mapped_over(lambda x: 2 * x, x))(X).jaxpr.eqns]
    assert names == ["mul"]


# Derivatives and lanes ------------------------------------------------------------------------------------------------


def curve(m, x, v):
    y = mapped_over(lambda m, x: jnp.tanh(m @ x), m, x)
    return rows_at(y, PLACES).T @ jnp.cos(v[:5]) + jnp.sum(v**3)


@pytest.mark.parametrize("moving", [(0, 1, 2), (1,), (2,)])
def test_forward_derivatives(moving):
    arguments = (M, X, V)
    program = ArrayProgram.of(lambda *x: [curve(*x)], *arguments)

    def along(function):
        def of_moving(*some):
            whole = list(arguments)
            for i, x in zip(moving, some, strict=True):
                whole[i] = x
            return function(*whole)

        primals = tuple(jnp.asarray(arguments[i]) for i in moving)
        tangents = tuple(jnp.cos(7 * x) for x in primals)
        return jax.jit(lambda: jax.jvp(of_moving, primals, tangents))()

    for found, expected in zip(along(lambda *x: program(*x)[0]), along(curve), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-13)


def test_several_tangents_and_lanes_and_second_derivatives():
    program = ArrayProgram.of(lambda *x: [curve(*x)], M, X, V)

    def function(v):
        return program(M, X, v)[0]

    def expected(v):
        return curve(jnp.asarray(M), jnp.asarray(X), v)

    v, w = jnp.asarray(V), jnp.asarray(np.stack([V, 2 * V]))
    for rule in (jax.jacfwd, lambda f: jax.jacfwd(jax.jacfwd(f))):
        np.testing.assert_allclose(jax.jit(rule(function))(v), rule(expected)(v), rtol=1e-12, atol=1e-13)
    found, wanted = (jax.jit(jax.vmap(jax.jacfwd(f)))(w) for f in (function, expected))
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(jax.jit(jax.vmap(function))(w), jax.vmap(expected)(w), rtol=1e-12)
    np.testing.assert_allclose(jax.vmap(function)(w[:1]), jax.vmap(expected)(w[:1]), rtol=1e-12)


def test_reverse_mode_is_refused():
    program = ArrayProgram.of(lambda *x: [curve(*x)], M, X, V)
    with pytest.raises(NotImplementedError, match="array_program"):
        jax.jit(jax.grad(lambda v: program(M, X, v)[0].sum()))(jnp.asarray(V))


def test_what_has_no_rule_is_left_to_xla():
    program = ArrayProgram.of(lambda x: [jnp.sort(x, 0)], X)
    assert not program.can_be_called
    np.testing.assert_array_equal(jax.jit(lambda x: program(x)[0])(X), np.sort(X, 0))


# Linear systems of blocks ---------------------------------------------------------------------------------------------

PATTERNS = {
    "alone": (3, ()),
    "chain": (7, tuple((i, i + 1) for i in range(6))),
    "ring": (6, (*((i, i + 1) for i in range(5)), (0, 5))),
    "hub": (9, tuple((0, i) for i in range(1, 9))),
    "all": (4, tuple((i, j) for i in range(4) for j in range(i + 1, 4))),
}


def blocks(name, m=3):
    n, pairs = PATTERNS[name]
    whole = np.zeros((n * m, n * m))
    for i, j in (*pairs, *((i, i) for i in range(n))):
        rows = np.unique(np.r_[i * m : i * m + m, j * m : j * m + m])
        a = RNG.standard_normal((len(rows), len(rows)))
        whole[np.ix_(rows, rows)] += a @ a.T
    cut = whole.reshape(n, m, n, m)
    off = np.array([cut[i, :, j] for i, j in pairs]).reshape(-1, m, m)
    return BlockPattern(n, pairs), np.stack([cut[i, :, i] for i in range(n)]), off, whole


@pytest.mark.parametrize("name", PATTERNS)
def test_block_solve(name):
    pattern, diagonal, pairs, whole = blocks(name)
    right = RNG.standard_normal((pattern.n_blocks, 3))
    found, by_xla = both(lambda *x: block_solve(pattern, *x), diagonal, pairs, right)
    np.testing.assert_allclose(found, by_xla, rtol=1e-11)
    np.testing.assert_allclose(found.ravel(), np.linalg.solve(whole, right.ravel()), rtol=1e-8)


def test_block_solve_leaves_redundant_equations_out_and_answers_an_indefinite_matrix_with_nan():
    pattern, diagonal, pairs, _ = blocks("chain")
    right = RNG.standard_normal((7, 3))
    diagonal[2, 1] = diagonal[2, :, 1] = 0.0
    diagonal[2, 1, 1] = 0.0
    pairs[1, :, 1] = pairs[2, 1] = 0.0
    found, by_xla = both(lambda *x: block_solve(pattern, *x), diagonal, pairs, right)
    assert found[2, 1] == 0
    np.testing.assert_allclose(found, by_xla, rtol=1e-11)
    diagonal[4, 0, 0] = -1.0
    found, by_xla = both(lambda *x: block_solve(pattern, *x), diagonal, pairs, right)
    assert np.all(np.isnan(found))
    assert np.all(np.isnan(by_xla))


def test_block_solve_with_several_right_sides_and_its_derivative():
    pattern, diagonal, pairs, _ = blocks("ring")
    right = RNG.standard_normal((6, 3))
    program = ArrayProgram.of(lambda *x: [block_solve(pattern, *x)], diagonal, pairs, right)
    primals = tuple(map(jnp.asarray, (diagonal, pairs, right)))
    tangents = tuple(map(jnp.cos, primals))
    found = jax.jit(lambda: jax.jvp(lambda *x: program(*x)[0], primals, tangents))()
    expected = jax.jvp(lambda *x: block_solve(pattern, *x), primals, tangents)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-11)
    columns = RNG.standard_normal((6, 3, 4))
    found, by_xla = both(
        lambda d, p, c: jax.vmap(lambda r: block_solve(pattern, d, p, r), -1, -1)(c), diagonal, pairs, columns
    )
    np.testing.assert_allclose(found, by_xla, rtol=1e-11)


# Places of arrays -----------------------------------------------------------------------------------------------------


def offsets(room):
    return {line.split()[0]: int(line.split()[-1]) for line in room[1:]}


def test_arrays_share_a_place_unless_they_are_in_use_together():
    lines = [
        "  store double 0.0, ptr %a, align 8",
        "  %p = getelementptr inbounds double, ptr %a, i64 3",
        "  store double 0.0, ptr %b, align 8",
        "  %x = load double, ptr %p, align 8",
        "  store double %x, ptr %c, align 8",
        "  %y = load double, ptr %b, align 8",
    ]
    found = offsets(shared_room({"%a": 640, "%b": 640, "%c": 640}, lines, 10_000).lines)
    assert found["%a"] == found["%c"]
    assert abs(found["%a"] - found["%b"]) >= 640


def test_an_array_that_is_in_use_in_a_loop_is_in_use_in_all_of_it():
    lines = [
        "turn1:",
        "  %x = load double, ptr %a, align 8",
        "  store double 0.0, ptr %b, align 8",
        "  br i1 %more, label %turn1, label %end2",
        "end2:",
    ]
    found = offsets(shared_room({"%a": 640, "%b": 640}, lines, 10_000).lines)
    assert abs(found["%a"] - found["%b"]) >= 640


def test_arrays_in_a_frame_are_in_use_until_the_call():
    lines = [
        "  store ptr %a, ptr %at1, align 8",
        "  store ptr %r, ptr %at2, align 8",
        "  %n = call ptr @function(ptr %frame)",
        "  %x = load double, ptr %r, align 8",
    ]
    found = offsets(shared_room({"%a": 640, "%r": 640}, lines, 10_000).lines)
    assert abs(found["%a"] - found["%r"]) >= 640


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(NotWrittenError, match="stack"):
        shared_room({"%a": 640}, ["  store double 0.0, ptr %a, align 8"], 100)
    given = shared_room({"%a": 640}, ["  store double 0.0, ptr %a, align 8"], 100, "%elsewhere")
    assert given.n_bytes == 640
    assert "ptr %elsewhere" in given.lines[0]
