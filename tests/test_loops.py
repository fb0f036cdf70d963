"""Loops of single runs in machine code: every operation, loops in loops, large arrays; against XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend import core as jex
from native_loops import in_machine_code

import spherejax as sj
from spherejax.compiler.emit.llvm_arrays import LARGE, NotWrittenError
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native import loop_fusion, loops
from spherejax.compiler.native.uninitialized import uninitialized
from spherejax.motion.integration import one_run
from spherejax.program_cache import folders

TS = jnp.linspace(0.0, 0.01, 4)
SPECIAL = np.array([0.0, -0.0, 1.0, -2.0, 0.5, np.nan, np.inf, -np.inf])


@pytest.fixture(autouse=True)
def on():
    if not machine_code.is_available():
        pytest.skip("no machine code with this jaxlib, or without llvmlite")
    with machine_code.native_code():
        yield


def once(function, *examples):
    """A function as the only turn of a loop, in machine code."""
    results = jax.eval_shape(function, *examples)
    begin = [jnp.zeros(each.shape, each.dtype) for each in results]

    def turned(*values):
        return jax.lax.while_loop(lambda s: s[0] < 1, lambda s: (s[0] + 1, function(*values)), (jnp.asarray(0), begin))[
            1
        ]

    return in_machine_code(turned, *examples)


def assert_same(found, expected):
    """Up to rounding: a sum in another order, a product and a sum in one."""
    assert len(found) == len(expected)
    for a, b in zip(map(np.asarray, found), map(np.asarray, expected), strict=True):
        assert a.dtype == b.dtype
        scale = np.abs(np.nan_to_num(b.astype(float), posinf=0, neginf=0)).max(initial=0.0)
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13 * scale)


# Every operation ------------------------------------------------------------------------------------------------------


def operations_of(*calls):
    """All operations in the loops of runs, once with each shape and parameter; loops and branches are gone into."""
    found = {}

    def walk(jaxpr):
        for equation in jaxpr.eqns:
            inner = [*jex.jaxprs_in_params(equation.params)]
            if not inner and equation.primitive.name not in (*machine_code.TARGETS, "straight_line", "platform_index"):
                atoms = tuple(str(a.val) if isinstance(a, jex.Literal) else str(a.aval) for a in equation.invars)
                found.setdefault((equation.primitive.name, atoms, str(equation.params)), equation)
            for each in inner:
                walk(each)

    def seen(parameters, values):
        walk(parameters["body_jaxpr"].jaxpr)
        walk(parameters["cond_jaxpr"].jaxpr)
        return loops.looped(parameters, values)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_fusion, "looped", seen)
        for call in calls:
            call()
    return [*found.values()]


def numbers_for(aval, rng):
    if aval.dtype == np.float64:
        numbers = rng.normal(size=aval.shape) * 10.0 ** rng.integers(-3, 3, size=aval.shape)
        is_special = rng.random(aval.shape) < 0.2 * (rng.random() < 0.5)
        return jnp.asarray(np.where(is_special, rng.choice(SPECIAL, size=aval.shape), numbers))
    if aval.dtype == bool:
        return jnp.asarray(rng.random(aval.shape) < 0.5)
    return jnp.asarray(rng.integers(0, 2, size=aval.shape), aval.dtype)


def height(joint, c):
    return sj.simulate(sj.gallery.four_bar(joint(c)), TS).ys[-1, 2]


def dry(c):
    return sj.Dry(c, friction=sj.Threlfall())


def film(c):
    return sj.Lubricated(c, viscosity=0.1)


@pytest.fixture(scope="module")
def operations():
    """Those of dry runs and films, with derivatives."""
    with pytest.MonkeyPatch.context() as patch:
        # What is kept would not be traced.
        patch.setattr(folders, "_in_use", [])
        found = operations_of(
            lambda: height(dry, 1.01e-4),
            lambda: jax.grad(lambda c: height(dry, c))(1.01e-4),
            lambda: height(film, 1.01e-4),
        )
    assert len(found) > 200
    return found


@pytest.mark.parametrize("seed", [0, 1])
def test_every_operation_of_a_run_is_that_of_jax(operations, seed):
    rng, small, changed = np.random.default_rng(seed), [], 0
    for equation in operations:
        if any(a.aval.size >= LARGE for a in equation.outvars):
            changed += 1  # in place: see below
            continue
        small.append((equation, [numbers_for(a.aval, rng) for a in equation.invars if not isinstance(a, jex.Literal)]))
    assert changed < 10

    def all_of_them(*values):
        given, results = iter(values), []
        for equation, numbers in small:
            own = iter([next(given) for _ in numbers])
            atoms = [
                jnp.asarray(a.val, a.aval.dtype) if isinstance(a, jex.Literal) else next(own) for a in equation.invars
            ]
            found = equation.primitive.bind(*atoms, **equation.params)
            results += found if equation.primitive.multiple_results else [found]
        return [x.astype(jnp.int64) if x.dtype == jnp.int32 else x for x in results]

    values = [x for _, numbers in small for x in numbers]
    assert_same(once(all_of_them, *values), jax.jit(all_of_them)(*values))


FUNCTIONS = {
    "library": lambda x, i, p: [jnp.exp(x), jnp.tanh(x), jnp.arctan2(x, 2.0), x**3, x**-2, jnp.abs(x) ** 0.3],
    "rounding": lambda x, i, p: [jnp.floor(x), jnp.ceil(x), jnp.sign(x), jnp.isfinite(x), jax.lax.rsqrt(x * x + 1.0)],
    "whole numbers": lambda x, i, p: [i + 3 * i - 1, jnp.maximum(i, 4), -i, jnp.abs(i - 5), i & 3, i == 2, ~(i > 3)],
    "types": lambda x, i, p: [x.astype(int), i.astype(float), p.astype(float), p.astype(int), x.astype(bool)],
    "truths": lambda x, i, p: [p & (x > 0), p | (x < 0), p ^ p, ~p, jnp.all(p), jnp.any(p), p == (i > 2), jnp.max(p)],
    "sums": lambda x, i, p: [x.sum(), x.reshape(3, 7).sum(0), x.reshape(3, 7).sum(1), x[:9].prod(), i.sum()],
    "extremes": lambda x, i, p: [x.max(), x.min(), i.max(), x.reshape(3, 7).max(1), jnp.minimum(x, 0.1 * i)],
    "truths alike": lambda x, i, p: [
        reduce(each)
        for reduce in (jnp.max, jnp.min, jnp.any, jnp.all)
        for each in (i > 9, i < 9, (i > 9)[:5], (i < 9)[:5], (i > 9).reshape(3, 7), (i < 9)[:1])
    ],
    "none": lambda x, i, p: [x[:0].sum(), x[:0].reshape(0, 3).sum(0), jnp.concatenate([x[:0], x]), jnp.all(p[:0])],
    "products": lambda x, i, p: [
        x[:7] @ x[7:14],
        x.reshape(3, 7) @ x[:7],
        x[:3] @ x.reshape(3, 7),
        x.reshape(3, 7) @ x.reshape(7, 3),
        jnp.einsum("bi,bi->b", x.reshape(3, 7), x.reshape(3, 7)),
        x[:18] @ x[3:],
    ],
    "moves": lambda x, i, p: [
        x[::-1],
        x.reshape(3, 7).T,
        jnp.roll(x, 2),
        jnp.pad(x, (2, 1)),
        x[2:20:3],
        jnp.repeat(x[:4], 2),
        jnp.stack([x, -x], 1),
        x.reshape(3, 1, 7) + x.reshape(3, 7, 1),
    ],
    "places": lambda x, i, p: [
        x[i[0]],
        x[i[:3]],
        jax.lax.dynamic_slice(x, (i[0] + 15,), (9,)),
        x.reshape(3, 7)[i[1] - 3],
        x.at[i[0]].set(7.0),
        x.at[i[0] + 40].set(7.0),
        x.at[i[2] + 40].get(mode="fill"),
        i.at[i[2] + 40].get(mode="fill", fill_value=5),
        jax.lax.dynamic_update_slice(x.reshape(3, 7), x[:4].reshape(2, 2), (i[0], i[1])),
    ],
    "choices": lambda x, i, p: [
        jnp.where(p, x, 0.0),
        jnp.clip(x, -1.0, 1.0),
        jax.lax.select_n(jnp.clip(i, 0, 2).astype(jnp.int32), x, 2 * x, 3 * x),
    ],
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_operations_are_those_of_jax(name):
    rng = np.random.default_rng(3)
    for _ in range(2):
        x = np.where(rng.random(21) < 0.1, rng.choice(SPECIAL[:5], 21), rng.normal(size=21) * 3.0)
        given = jnp.asarray(x), jnp.asarray(rng.integers(0, 7, 21)), jnp.asarray(rng.random(21) < 0.5)
        assert_same(once(FUNCTIONS[name], *given), jax.jit(FUNCTIONS[name])(*given))


# Loops and branches ---------------------------------------------------------------------------------------------------


def wandering(y, weights, n):
    """Loops in loops that change places of what they carry, in both directions, and branches."""

    def stage(k, row):
        k = k + 0.1 * jnp.sin(row[0] * k[::-1])
        return k, (k.sum(), jnp.stack([k[0], row[1]]), jnp.array(2.0))

    def turn(state):
        i, a, b, flag, total, kept = state
        k, (sums, pairs, _) = jax.lax.scan(stage, a, weights, reverse=True)
        _, j = jax.lax.while_loop(lambda s: s[0] > 1.0, lambda s: (s[0] / 3.0, s[1] + 1), (jnp.abs(k).sum() + 9.0, i))
        b = jax.lax.switch(jnp.minimum(j, 3), [jnp.negative, lambda x: x + pairs[1], lambda x: x * x[0]], b)
        c = jax.lax.cond(flag & (i > 1), lambda: (a, total), lambda: (k, total + sums[0]))
        return i + 1, b[:2].repeat(2)[:3] + c[0], c[0][:2] * 0.9, ~flag, c[1], kept.at[i].set(sums[1])

    begin = jnp.asarray(0), y, y[:2], jnp.asarray(True), 0.0, jnp.zeros(9)
    return [*jax.lax.while_loop(lambda s: (s[0] < n) & (s[4] < 1e9), turn, begin)]


def swapping(y, weights, n):
    """What is carried goes round."""
    begin = jnp.asarray(0), y, 2 * y, 3 * y
    return [*jax.lax.while_loop(lambda s: s[0] < n, lambda s: (s[0] + 1, s[2], s[3] + weights[0, 0], s[1]), begin)]


@pytest.mark.parametrize("function", [wandering, swapping])
@pytest.mark.parametrize("n", [0, 1, 2, 7])
def test_loops_and_branches_are_those_of_jax(function, n):
    given = jnp.array([0.3, -1.2, 2.0]), jnp.array([[0.4, 1.0], [-0.8, 2.0], [1.7, 0.1]]), jnp.asarray(n)
    assert_same(in_machine_code(function, *given), jax.jit(function)(*given))


def writing_down(y, n):
    """Rows of a large array, of which some branch writes one."""

    def turn(state):
        i, y, rows = state
        y = y * 1.1 + jnp.roll(y, 1)
        writes = jnp.sin(10.0 * i) > 0
        rows = jax.lax.cond(writes, lambda r: jax.lax.dynamic_update_slice(r, y[None], (i, 0)), lambda r: r, rows)
        return i + 1, y, rows.at[i + 1, 3].set(-1.0)

    begin = jnp.asarray(0), y, jnp.full((LARGE // 8 + 1, y.size), jnp.nan)
    return [*jax.lax.while_loop(lambda s: s[0] < n, turn, begin)]


def reading_what_was(y, n):
    """A large array that is read after it was changed: not to be done in place."""

    def turn(state):
        i, rows = state
        changed = rows.at[i].set(y)
        return i + 1, changed + 0.0 * rows[0, 0]

    rows = jnp.ones((LARGE // 8 + 1, y.size))
    return [*jax.lax.while_loop(lambda s: s[0] < n, turn, (jnp.asarray(0), rows))]


def reading_late(y, n):
    """The same, of one entry."""

    def turn(state):
        i, rows, total = state
        changed = rows.at[i].set(y)
        return i + 1, changed, total + rows[i, 0]

    begin = jnp.asarray(0), jnp.ones((LARGE // 8 + 1, y.size)), jnp.asarray(0.0)
    return [*jax.lax.while_loop(lambda s: s[0] < n, turn, begin)]


def reading_the_begin(y, n):
    """A large array that a loop begins with, and that is read behind the loop as it was."""
    begin = jnp.outer(jnp.arange(LARGE // 8 + 1.0), y)
    i, rows = jax.lax.while_loop(
        lambda s: s[0] < n, lambda s: (s[0] + 1, s[1].at[s[0]].set(y)), (jnp.asarray(0), begin)
    )
    return [i, rows, begin, begin + rows]


def of_large_arrays(y, n):
    """Sums and products of arrays that are larger than those which loops change in place as a rule."""
    many = jnp.outer(jnp.linspace(0.0, 1.0, LARGE // 4), y).ravel()

    def turn(state):
        i, sums, rows = state
        sums = jnp.where(sums > 1.0, 0.5 * sums, sums + many * jnp.sin(1.0 * i))
        return i + 1, sums, rows.at[i].set(sums[-y.size :])

    begin = jnp.asarray(0), jnp.zeros_like(many), jnp.zeros((LARGE, y.size))
    return [*jax.lax.while_loop(lambda s: s[0] < n, turn, begin)]


@pytest.fixture
def loops_call(monkeypatch):
    """Any loop counts as one that calls machine code; others are left alone before anybody looks at them."""
    monkeypatch.setattr(loop_fusion, "_calls", lambda equation: equation.primitive.name == "while")


@pytest.fixture
def left_to_xla(loops_call, caplog):
    """What few kernels make of a function, and what the log says."""
    caplog.set_level("INFO")

    def left(function, *examples):
        caplog.clear()
        with machine_code.native_code():
            found = jax.jit(loop_fusion.fuse_loops(function))(*examples)
        return found, caplog.text

    return left


def test_large_arrays_are_changed_in_place_or_not_at_all(left_to_xla):
    y = jnp.arange(8.0)
    given = y, jnp.asarray(12)
    before = np.asarray(y).copy()
    assert_same(in_machine_code(writing_down, *given), jax.jit(writing_down)(*given))
    np.testing.assert_array_equal(y, before)
    for function in (reading_what_was, reading_late):
        with pytest.raises(NotWrittenError):
            in_machine_code(function, *given)
        found, said = left_to_xla(function, *given)
        assert_same(found, jax.jit(function)(*given))
        assert "left to XLA: a large array that is read after it was changed" in said


@pytest.mark.parametrize("function", [reading_the_begin, of_large_arrays])
def test_large_arrays_are_those_of_xla(function):
    given = jnp.linspace(0.3, 1.7, 8), jnp.asarray(12)
    assert_same(in_machine_code(function, *given), jax.jit(function)(*given))


def test_a_loop_writes_into_an_array_that_nobody_has_filled():
    def rows_of(y):
        rows = uninitialized((LARGE, y.size))
        rows = jax.lax.fori_loop(0, LARGE, lambda i, rows: rows.at[i].set(i * y), rows)
        return rows, uninitialized((LARGE, y.size)).at[:].set(y)

    y = jnp.array([0.5, -2.0])
    expected = np.arange(LARGE)[:, None] * np.asarray(y), np.broadcast_to(y, (LARGE, 2))
    for made in (jax.jit(rows_of)(y), jax.vmap(rows_of)(y[None]), rows_of(y)):
        for found, right in zip(made, expected, strict=True):
            np.testing.assert_array_equal(found.reshape(right.shape), right)


def test_what_has_no_rule_is_left_to_xla(left_to_xla):
    def sorting(y, n):
        return [*jax.lax.while_loop(lambda s: s[0] < n, lambda s: (s[0] + 1, jnp.sort(-s[1])), (jnp.asarray(0), y))]

    given = jnp.array([3.0, 1.0, 2.0]), jnp.asarray(3)
    with pytest.raises(NotWrittenError, match="'sort' has no rule"):
        in_machine_code(sorting, *given)
    found, said = left_to_xla(sorting, *given)
    assert_same(found, jax.jit(sorting)(*given))
    assert "left to XLA: the operation 'sort' has no rule" in said


# Runs -----------------------------------------------------------------------------------------------------------------

MODELS = {
    "ideal": sj.Ideal(),
    "bushing": sj.Bushing(1e6, 1e-4),
    "dry": sj.Dry(1e-4),
    "friction": sj.Dry(1e-4, friction=sj.Threlfall()),
    "film": sj.Lubricated(1e-4, viscosity=0.1),
}


@pytest.mark.parametrize("name", MODELS)
def test_loops_of_runs_are_written_and_move_as_before(name, monkeypatch):
    monkeypatch.setattr(folders, "_in_use", [])
    scene, ts = sj.gallery.four_bar(MODELS[name]), jnp.linspace(0.0, 0.011, 5)
    asked = []

    def counted(parameters, values):
        asked.append("written")
        return loops.looped(parameters, values)

    def refused(parameters, values):
        asked.append("refused")
        raise NotWrittenError("by a test")

    found = []
    for how in (counted, refused):
        with monkeypatch.context() as patch:
            patch.setattr(loop_fusion, "looped", how)
            for program in (one_run.before_first_window, one_run.advance_window, one_run.integrated):
                program.clear()
            found.append(np.asarray(sj.simulate(scene, ts, rtol=1e-9).ys))
    assert {*asked} == {"written", "refused"}
    np.testing.assert_allclose(found[0], found[1], rtol=1e-8, atol=1e-8)


@pytest.mark.usefixtures("loops_call")
def test_a_loop_under_vmap_is_made_for_each():
    y, weights = jnp.array([0.3, -1.2, 2.0]), jnp.array([[0.4, 1.0], [-0.8, 2.0]])
    counts = jnp.array([0, 3, 1])
    made = jax.vmap(lambda n: loop_fusion.fuse_loops(swapping)(y, weights, n))
    with machine_code.native_code():
        assert "= mapped_in_machine_code[" in str(jax.make_jaxpr(made)(counts))
        found = jax.jit(made)(counts)
    assert_same(found, jax.vmap(lambda n: swapping(y, weights, n))(counts))


def test_without_jit_a_run_is_made_by_jax_alone():
    scene, ts = sj.gallery.simple_pendulum(), jnp.array([0.0, 1e-4])
    expected = sj.simulate(scene, ts).ys
    with jax.disable_jit():
        np.testing.assert_allclose(sj.simulate(scene, ts).ys, expected, rtol=1e-12, atol=1e-12)


def test_whole_numbers_of_32_bits_wrap_around():
    """As a law may have that makes noise by a generator of its own; machine code computes with 64 bits."""

    def noise(x):
        def turn(carry):
            i, k, total = carry
            k = k * jnp.int32(1664525) + jnp.int32(1013904223)
            wide = (k.astype(jnp.int64) * 3).astype(jnp.int32)
            return i + 1, jnp.where(-k > 0, k, wide - k), total + k.astype(jnp.float64) * x

        seed = jnp.where(x > 0, 7, 5)
        begin = jnp.zeros((), jnp.int64), seed.astype(jnp.int64), jnp.zeros(())

        def widened(carry):
            i, k, total = turn((carry[0], carry[1].astype(jnp.int32), carry[2]))
            return i, k.astype(jnp.int64), total

        return jax.lax.while_loop(lambda carry: carry[0] < 9, widened, begin)[1:]

    results, expected = in_machine_code(noise, jnp.array(0.5)), noise(jnp.array(0.5))
    for one, other in zip(results, expected, strict=True):
        np.testing.assert_array_equal(one, other)
    assert abs(int(results[0])) < 2**31
