"""Many runs of a program of machine code: each is what it is alone, whatever the number of threads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import native_code
from spherejax.compiler.native import loop_fusion, mapped_programs
from spherejax.compiler.native.uninitialized import uninitialized

pytestmark = pytest.mark.skipif(not native_code.is_available(), reason="no machine code with this jaxlib")

RNG = np.random.default_rng(0)
N = 7
YS, COUNTS = jnp.asarray(RNG.standard_normal((N, 3))), jnp.asarray(RNG.integers(1, 300, N))
SHARED = jnp.asarray(RNG.standard_normal((40, 3)))


@pytest.fixture(autouse=True)
def all_loops(monkeypatch):
    """Any loop counts as one that calls machine code."""
    monkeypatch.setattr(loop_fusion, "_calls", lambda equation: equation.primitive.name == "while")


@pytest.fixture(params=[1, 2, 5, 64])
def threads(request, monkeypatch):
    monkeypatch.setattr(mapped_programs, "_n_processors", lambda: request.param)


def walk(y, n, shared):
    """A loop that writes rows, and takes as long as it is told."""

    def turn(state):
        i, y, rows, results = state
        y = 0.5 * y + shared[jnp.minimum(i, 39)]
        rows = rows.at[i].set(y)
        return i + 1, y, rows, results | (rows[i, 0] > 1.0)

    begin = jnp.asarray(0), y, uninitialized((400, 3)), jnp.asarray(False)
    _, y, rows, results = jax.lax.while_loop(lambda s: s[0] < n, turn, begin)
    return jnp.sin(y), rows[n - 1], results, n + 1, jnp.zeros((0, 3))


def one_call(*arguments):
    return native_code(is_one_call=True)(walk)(*arguments)


def operations(function, *arguments):
    return [e.primitive.name for e in jax.make_jaxpr(function)(*arguments).jaxpr.eqns]


def assert_same(results, expected):
    for one, other in zip(jax.tree.leaves(results), jax.tree.leaves(expected), strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("threads")
@pytest.mark.parametrize("axes", [(0, 0, None), (0, None, None), (None, 0, None), (1, 0, 2)])
def test_each_of_many_is_what_it_is_alone(axes):
    y = YS if axes[0] == 0 else YS.T if axes[0] == 1 else YS[0]
    n = COUNTS if axes[1] == 0 else COUNTS[0]
    shared = SHARED if axes[2] is None else jnp.stack([SHARED * k for k in range(N)], 2)
    many = jax.vmap(one_call, axes)
    assert "mapped_in_machine_code" in operations(many, y, n, shared)
    results = jax.jit(many)(y, n, shared)

    def part(array, axis, i):
        return array if axis is None else jnp.take(array, i, axis)

    alone = jax.jit(one_call)
    singles = [alone(part(y, axes[0], i), part(n, axes[1], i), part(shared, axes[2], i)) for i in range(N)]
    assert_same(results, jax.tree.map(lambda *parts: jnp.stack(parts), *singles))


@pytest.mark.usefixtures("threads")
def test_many_of_many():
    many = jax.vmap(jax.vmap(one_call, (0, None, None)), (None, 0, None))
    results = jax.jit(many)(YS, COUNTS[:3], SHARED)
    singles = [jax.jit(jax.vmap(one_call, (0, None, None)))(YS, n, SHARED) for n in COUNTS[:3]]
    assert_same(results, jax.tree.map(lambda *parts: jnp.stack(parts), *singles))


def test_where_the_system_starts_no_thread_the_others_make_all_runs(monkeypatch):
    text = mapped_programs._MappedText
    started = text._started

    def refused(t):
        return ["  %failed.1 = add i32 0, 11"] if t == 1 else started(t)

    monkeypatch.setattr(mapped_programs, "_n_processors", lambda: 3)
    monkeypatch.setattr(text, "_started", staticmethod(refused))
    results = jax.jit(jax.vmap(one_call, (0, 0, None)))(YS, COUNTS, SHARED)
    singles = [jax.jit(one_call)(y, n, SHARED) for y, n in zip(YS, COUNTS, strict=True)]
    assert_same(results, jax.tree.map(lambda *parts: jnp.stack(parts), *singles))


@pytest.mark.usefixtures("threads")
def test_no_runs_at_all():
    results = jax.jit(jax.vmap(one_call, (0, 0, None)))(YS[:0], COUNTS[:0], SHARED)
    assert [x.shape for x in results] == [(0, 3), (0, 3), (0,), (0,), (0, 0, 3)]
