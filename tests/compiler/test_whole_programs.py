"""Programs with loops as one call of machine code, and the operations that only these have: against XLA."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import native_code, scalarize
from spherejax.compiler.emit.llvm_arrays import (
    LARGEST_STACK,
    ChangedInPlaceError,
    InPlace,
    TooManyEntriesError,
    within_limits,
)
from spherejax.compiler.native import loop_fusion, loops
from spherejax.compiler.native.loops import LOOP
from spherejax.compiler.native.uninitialized import uninitialized

pytestmark = pytest.mark.skipif(not native_code.is_available(), reason="no machine code with this jaxlib")

RNG = np.random.default_rng(0)
Y = jnp.asarray(RNG.standard_normal(3))
MANY = jnp.asarray(RNG.standard_normal(2003))
SHUFFLED = RNG.permutation(60)[:40]
TWO = RNG.permutation(30).reshape(15, 2)


@pytest.fixture(autouse=True)
def all_loops(monkeypatch):
    """Any loop counts as one that calls machine code."""
    monkeypatch.setattr(loop_fusion, "_calls", lambda equation: equation.primitive.name == "while")


def halved(x, n=3):
    """A loop around something."""
    return jax.lax.while_loop(lambda s: s[0] < n, lambda s: (s[0] + 1, 0.5 * s[1]), (0, x))[1]


def one_call(function):
    return native_code(is_one_call=True)(function)


def operations(function, *arguments):
    """The names of the operations that a function consists of."""
    return [e.primitive.name for e in jax.make_jaxpr(function)(*arguments).jaxpr.eqns]


def assert_same(results, expected, rtol=1e-13):
    for one, other in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        assert one.shape == other.shape
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=rtol, atol=1e-14)


AROUND = {
    "entry by entry": lambda y, x: (jnp.sin(halved(y)) + x[:3], y > 0, jnp.asarray(3) + jnp.sum(x > 0)),
    "the largest": lambda y, x: halved(y) * jnp.max(jnp.abs(x)) - jnp.min(x),
    "all and any": lambda y, x: (halved(y), jnp.all(x < 9), jnp.any(x > 9)),
    "a long sum": lambda y, x: halved(y) + jnp.sum(x),
    "sums so far": lambda y, x: (halved(y), jnp.cumsum(x), jnp.cumsum(x[:60].reshape(20, 3), axis=0)),
    "counts so far": lambda y, x: (halved(y), jnp.cumsum(x > 0), jnp.cumsum(x[:1])),
    "taken": lambda y, x: (halved(y), x[:60][SHUFFLED], x[1000:1060].reshape(30, 2)[TWO]),
    "the transpose of taken": lambda y, x: jax.vjp(lambda x: halved(y) * jnp.sum(x[:60][SHUFFLED] ** 2), x)[1](y),
    "added to places": lambda y, x: (halved(y), x[:60].at[SHUFFLED].add(x[100:140])),
    "rows that are added": lambda y, x: (halved(y), x[:90].reshape(30, 3).at[TWO[:, 0]].add(x[:45].reshape(15, 3))),
    "a branch": lambda y, x: jax.lax.cond(x[0] > 0, lambda: x * y[0], lambda: -x) + halved(y)[1],
    "two loops": lambda y, x: halved(jnp.concatenate([halved(y), x[:4]])),
}


@pytest.mark.parametrize("name", AROUND)
def test_what_is_around_a_loop_is_part_of_the_call(name):
    function = AROUND[name]
    made = one_call(function)
    assert operations(made, Y, MANY) == [LOOP]
    assert_same(jax.jit(made)(Y, MANY), jax.jit(function)(Y, MANY), rtol=1e-12)


def test_room_is_changed_in_place_by_loops_behind_each_other():
    def written(rows, begin, y):
        def turn(state):
            i, rows = state
            return i + 1, rows.at[i].set(i * y)

        return jax.lax.while_loop(lambda s: s[0] < begin + 200, turn, (begin, rows))[1]

    def function(y):
        rows = written(uninitialized((400, y.size)), jnp.asarray(0), y)
        rows = written(rows, jnp.asarray(200), 2 * y)
        return rows[7] + rows[390], rows

    def as_arrays(y):
        rows = jnp.arange(400)[:, None] * jnp.where(jnp.arange(400)[:, None] < 200, 1, 2) * y
        return rows[7] + rows[390], rows

    made = one_call(function)
    names = operations(made, Y)
    assert names == ["uninitialized", LOOP]
    assert_same(jax.jit(made)(Y), as_arrays(Y))
    several = jnp.stack([Y, -Y, 3 * Y])
    assert_same(jax.jit(jax.vmap(made))(several), jax.vmap(as_arrays)(several))
    # The room is changed where it is: it is read by nothing else, so that XLA has no reason to copy it.
    assert "copy(" not in str(jax.jit(made).lower(Y).compile().as_text())


def test_room_of_which_a_row_is_written_ahead_of_its_loop_stays_where_it_is():
    def function(y):
        rows = jax.lax.dynamic_update_slice(uninitialized((400, y.size)), -y[None], (0, 0))

        def turn(state):
            i, rows = state
            return i + 1, rows.at[i].set(i * y)

        rows = jax.lax.while_loop(lambda s: s[0] < 300, turn, (jnp.asarray(1), rows))[1]
        return rows[:300]

    made = one_call(function)
    assert operations(made, Y) == ["uninitialized", LOOP]
    np.testing.assert_array_equal(jax.jit(made)(Y), jnp.arange(300)[:, None] * Y - jnp.eye(300)[0][:, None] * Y)
    assert "copy(" not in str(jax.jit(made).lower(Y).compile().as_text())


def test_room_that_nobody_reads_behind_is_handed_on_by_mapped_runs():
    def function(y):
        def turn(state):
            i, rows, total = state
            rows = rows.at[i].set(i * y)
            return i + 1, rows, total + rows[i]

        begin = jnp.asarray(0), uninitialized((400, y.size)), jnp.zeros_like(y)
        return jax.lax.while_loop(lambda s: s[0] < 200, turn, begin)[2]

    made = one_call(function)
    assert operations(made, Y) == ["uninitialized", LOOP]
    several = jnp.stack([Y, -Y, 3 * Y])
    expected = sum(range(200)) * several
    np.testing.assert_allclose(jax.jit(jax.vmap(made))(several), expected, rtol=1e-13)
    program = str(jax.jit(jax.vmap(made)).lower(several).compile().as_text())
    assert not [line for line in program.splitlines() if "copy(" in line and "f64[400,3]" in line]


def test_an_array_that_is_read_as_a_whole_is_none_that_stays():
    def function(y):
        def turn(state):
            i, rows, total = state
            rows = rows.at[i].set(y)
            return i + 1, rows, total + rows

        begin = jnp.asarray(0), jnp.zeros((200, 3)), jnp.zeros((200, 3))
        rows = jax.lax.while_loop(lambda s: s[0] < 5, turn, begin)
        return rows, begin[1]

    made = one_call(function)
    assert operations(made, Y) == [LOOP]
    assert_same(jax.jit(made)(Y), jax.jit(function)(Y))


def test_a_room_of_which_two_versions_are_read_is_copied():
    def function(y):
        def turn(state):
            i, rows = state
            later = rows.at[i].set(2 * rows[i] + y)
            return i + 1, later.at[i + 1].set(rows[i] - later[i])

        return jax.lax.while_loop(lambda s: s[0] < 5, turn, (jnp.asarray(0), jnp.ones((200, 3))))[1]

    made = one_call(function)
    assert operations(made, Y) == [LOOP]
    assert_same(jax.jit(made)(Y), jax.jit(function)(Y))


def test_what_has_no_rule_is_left_to_xla_around_the_loops(caplog):
    caplog.set_level("INFO")

    def function(y):
        return jnp.sort(halved(y))

    made = one_call(function)
    assert LOOP in operations(made, Y)
    assert "what is around the loops of a run is left to XLA: the operation 'sort' has no rule" in caplog.text
    assert_same(jax.jit(made)(Y), jax.jit(function)(Y))


def test_without_a_loop_there_is_no_call():
    assert LOOP not in operations(one_call(jnp.sin), Y)


def test_places_that_are_added_to_twice_are_left_to_xla(caplog):
    caplog.set_level("INFO")

    def function(y, x):
        return halved(y), x.at[jnp.array([3, 3, 1])].add(y)

    assert_same(jax.jit(one_call(function))(Y, MANY), jax.jit(function)(Y, MANY))
    assert "adds twice in one place" in caplog.text


def test_indices_within_a_loop_are_written_into_its_text():
    """Numbers that are picked by an array of 32-bit indices, which is known when the text is written."""

    def function(y, x):
        def turn(state):
            i, total = state
            return i + 1, total + x[jnp.asarray(SHUFFLED, jnp.int32)] * y[0]

        return jax.lax.while_loop(lambda s: s[0] < 3, turn, (0, jnp.zeros(SHUFFLED.size)))[1]

    made = one_call(function)
    (call,) = jax.make_jaxpr(made)(Y, MANY[:60]).jaxpr.eqns
    assert call.primitive.name == LOOP
    assert all(v.aval.dtype == jnp.float64 or v.aval.size == 1 for v in call.invars)
    assert_same(jax.jit(made)(Y, MANY[:60]), jax.jit(function)(Y, MANY[:60]))


@pytest.mark.parametrize("is_mapped", [False, True])
def test_arrays_that_the_stack_has_no_room_for_are_in_a_result_that_nobody_sees(monkeypatch, is_mapped):
    """A loop within and what is around it compute with thousands of numbers."""

    def turned(x):
        return jnp.concatenate([x[1000:], x[:1000]])

    def function(y, x):
        def turn(state):
            i, x = state
            return i + 1, jnp.sin(turned(x)) * y[0] + x

        _, x = jax.lax.while_loop(lambda s: s[0] < 3, turn, (0, jnp.cos(x) + y[2]))
        return jnp.sqrt(x * x) + turned(x), jnp.max(x)

    many = jnp.linspace(0.0, 1.0, 5000)
    several = jnp.stack([Y, 2 * Y, -Y]) if is_mapped else Y

    def mapped(function):
        return jax.vmap(function, (0, None)) if is_mapped else function

    expected = jax.jit(mapped(function))(several, many)
    for largest, has_room in ((LARGEST_STACK, False), (2**14, True)):
        monkeypatch.setattr(loops, "LARGEST_STACK", largest)
        made = one_call(function)
        (call,) = jax.make_jaxpr(made)(Y, many).jaxpr.eqns
        assert (call.params["written"].n_room > 0) == has_room
        assert_same(jax.jit(mapped(made))(several, many), expected, rtol=1e-12)


def test_limits():
    """Arrays that are computed with raise the limit; one that is read after it was changed takes rooms away."""
    asked = []

    def written(limits):
        asked.append(limits)
        if limits.has_rooms:
            raise ChangedInPlaceError
        if limits.large < 16384:
            raise TooManyEntriesError
        return limits

    assert within_limits(written) == InPlace(16384, has_rooms=False)
    assert asked == [InPlace(4096, True), InPlace(4096, False), InPlace(8192, False), InPlace(16384, False)]
    asked.clear()

    def written_of_many(limits):
        asked.append(limits.large)
        if limits.large <= 40_000:
            raise TooManyEntriesError("an array", 40_000)
        return limits.large

    assert within_limits(written_of_many) == 65_536
    assert asked == [4096, 65_536]  # each attempt writes the whole text
    with pytest.raises(TooManyEntriesError):
        within_limits(lambda limits: (_ for _ in ()).throw(TooManyEntriesError("an array", 10**6)))
    with pytest.raises(ChangedInPlaceError):
        within_limits(lambda limits: (_ for _ in ()).throw(ChangedInPlaceError))


@pytest.mark.parametrize(("axis", "reverse"), [(0, False), (1, False), (0, True), (1, True)])
def test_sums_so_far_in_a_scalar_program(axis, reverse):
    def function(x):
        return jax.lax.cumsum(jnp.sin(x), axis, reverse)

    x = MANY[:12].reshape(4, 3)
    program = scalarize(function, x)
    assert_same(program(x), function(x))
    weights = MANY[20:32].reshape(4, 3)
    slopes = [jax.grad(lambda x, f=f: jnp.sum(weights * f(x)))(x) for f in (program, function)]
    assert_same(*slopes)
