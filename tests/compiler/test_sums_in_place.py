"""Sums that a loop carries, added to in place by the calls that make their terms: the numbers of JAX's loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from native_loops import in_machine_code

from spherejax.compiler import native_code, scalarize
from spherejax.compiler.native import loops
from spherejax.compiler.native.loops import LoopText


@pytest.fixture(autouse=True)
def on():
    with native_code():
        if not native_code.is_enabled():
            pytest.skip("no machine code with this jaxlib, or without llvmlite")
        yield


@pytest.fixture
def additions(monkeypatch):
    """How many results of calls, and how many arrays, have been added in place, and rows of how many behind a loop."""
    counts = {"by calls": 0, "of arrays": 0, "behind loops": 0}

    def count(name, what, size):
        method = getattr(LoopText, name)

        def counted(text, *arguments):
            counts[what] += size(*arguments)
            return method(text, *arguments)

        monkeypatch.setattr(LoopText, name, counted)

    count("adding_line", "by calls", lambda equation, values, into: len(into))
    count("_added", "of arrays", lambda *_: 1)
    count("_add_products", "behind loops", lambda *_: 1)
    return counts


def layers(width):
    """A network with two layers of weights, in one vector with their biases and three numbers that it does not read."""
    sizes = [width * 2, width, width * width, width, width]
    ends = np.cumsum(sizes)

    def network(w, x):
        first, b, second, c, last = jnp.split(w[: ends[-1]], ends[:-1])
        y = jnp.tanh(first.reshape(width, 2) @ x + b)
        y = jnp.tanh(second.reshape(width, width) @ y + c)
        return last @ y

    return network, 0.5 * jnp.asarray(np.random.default_rng(0).normal(size=ends[-1] + 3))


def turned(turn):
    """Five turns of a loop; each makes of the sum so far, the point and its own number the next sum and point."""

    def function(w, x):
        def body(state):
            i, total, x = state
            total, x = turn(total, x, i, w)
            return i + 1, total, 0.9 * x

        return [*jax.lax.while_loop(lambda state: state[0] < 5, body, (jnp.asarray(0), jnp.full_like(w, 0.25), x))]

    return function


def cases_of(network):
    """Turns, each with what is added in place, as of `additions`."""

    def by_weights(w, x):
        return jax.grad(network)(w, x)

    def added(total, x, i, w):
        return total + by_weights(w, x), x

    def added_the_other_way(total, x, i, w):
        return by_weights(w, x) + total, x

    def with_the_other_results(total, x, i, w):
        value, back = jax.vjp(network, w, x)
        of_w, of_x = back(1.0 + 0.1 * value)
        return total + of_w, x + 0.1 * of_x

    def the_sum_is_read(total, x, i, w):
        total = total + by_weights(w, x)
        return total, x + 0.1 * total[200:202]

    def the_sum_before_is_read(total, x, i, w):
        return total + by_weights(w, x), x + 0.1 * total[200:202]

    def the_term_is_read(total, x, i, w):
        term = by_weights(w, x)
        return total + term, x + 0.1 * term[200:202]

    def a_difference(total, x, i, w):
        return by_weights(w, x) - total, x

    def a_multiple(total, x, i, w):
        return total + 2.0 * by_weights(w, x), x

    def two_terms(total, x, i, w):
        return total + by_weights(w, x) + by_weights(w, jnp.sin(x)), x

    def two_terms_the_last_one_first(total, x, i, w):
        last = by_weights(w, jnp.sin(x))
        return total + by_weights(w, x) + last, x

    def an_array(total, x, i, w):
        return total + jnp.sin(w * x[0]), x

    def in_another_shape(total, x, i, w):
        return (total[None] + by_weights(w, x)[None])[0], x

    def in_some_turns(total, x, i, w):
        return jax.lax.cond(jnp.sin(2.0 * i) > 0, lambda total: total + by_weights(w, x), lambda total: total, total), x

    def in_both_branches(total, x, i, w):
        def one(total, x):
            return total + by_weights(w, x), x

        def other(total, x):
            return total + jnp.sin(w) + by_weights(w, 2.0 * x), 0.5 * x

        return jax.lax.cond(jnp.sin(2.0 * i) > 0, one, other, total, x)

    def a_branch_with_another_array(total, x, i, w):
        return jax.lax.cond(
            jnp.sin(2.0 * i) > 0, lambda total: total + by_weights(w, x), lambda total: 2.0 * total, total
        ), x

    def a_branch_that_shows_the_sum(total, x, i, w):
        def one(total):
            total = total + by_weights(w, x)
            return total, total.reshape(-1)

        total, same = jax.lax.cond(jnp.sin(2.0 * i) > 0, one, lambda total: (total, w), total)
        return total + by_weights(w, x), x + 0.1 * same[200:202]

    def of_points(w, x):
        return jnp.outer(jnp.linspace(0.5, 1.0, 3), x)

    def in_a_scan(total, x, i, w):
        one = jax.lax.scan(lambda total, x: (total + by_weights(w, x), None), total, of_points(w, x))
        return one[0], x

    def from_zeros_in_a_scan(total, x, i, w):
        begin = jnp.zeros_like(w)
        return total + jax.lax.scan(lambda t, x: (t + by_weights(w, x), x[0]), begin, of_points(w, x))[0], x

    def from_ones_in_a_scan(total, x, i, w):
        begin = jnp.ones_like(w)
        return total + jax.lax.scan(lambda t, x: (t + by_weights(w, x), x[0]), begin, of_points(w, x))[0], x

    def a_scan_that_shows_its_sums(total, x, i, w):
        def one(t, x):
            t = t + by_weights(w, x)
            return t, t[200:202]

        more, shown = jax.lax.scan(one, jnp.zeros_like(w), of_points(w, x))
        return total + more, x + 0.1 * shown[1]

    def a_scan_that_reads_its_sums(total, x, i, w):
        more, _ = jax.lax.scan(lambda t, x: (t + by_weights(w, x + 0.01 * t[200:202]), None), 0 * w, of_points(w, x))
        return total + more, x

    def a_scan_that_is_read(total, x, i, w):
        more, _ = jax.lax.scan(lambda t, x: (t + by_weights(w, x), None), jnp.zeros_like(w), of_points(w, x))
        return total + more, x + 0.1 * more[200:202]

    def a_scan_with_a_branch_that_shows_its_sums(total, x, i, w):
        def one(state, x):
            t, _ = state

            def more(t):
                t = t + by_weights(w, x)
                return t, t[200:202]

            return jax.lax.cond(x[0] > 0.1, more, lambda t: (t, x), t), None

        (more, shown), _ = jax.lax.scan(one, (jnp.zeros_like(w), x), of_points(w, x))
        return total + more, x + 0.1 * shown

    def a_scan_with_a_loop_that_looks_at_its_sums(total, x, i, w):
        def one(t, x):
            def body(s):
                return s[0] + by_weights(w, x), s[1] + 1

            return jax.lax.while_loop(lambda s: (s[1] < 3) & (s[0][0] < 0.05), body, (t, 0))[0], None

        return total + jax.lax.scan(one, jnp.zeros_like(w), of_points(w, x))[0], x

    def a_loop_that_looks_at_its_sums(total, x, i, w):
        def body(s):
            return s[0] + by_weights(w, x), s[1] + 1

        return jax.lax.while_loop(lambda s: (s[1] < 3) & (s[0][0] < 0.3), body, (total, 0))[0], x

    def back_along_a_scan(total, x, i, w):
        def end(w, x):
            return jnp.sum(jax.lax.scan(lambda x, _: (x + 0.1 * network(w, x), None), x, length=4)[0])

        of_w, of_x = jax.grad(end, (0, 1))(w, x)
        return total + of_w, x + 0.1 * of_x

    def in_a_program(total, x, i, w):
        return jax.jit(added)(total, x, i, w)

    return {
        added: (1, 0, 0),
        added_the_other_way: (1, 0, 0),
        with_the_other_results: (1, 0, 0),
        the_sum_is_read: (1, 0, 0),
        the_sum_before_is_read: (0, 0, 0),
        the_term_is_read: (0, 1, 0),
        a_difference: (0, 0, 0),
        a_multiple: (0, 1, 0),
        two_terms: (2, 0, 0),
        two_terms_the_last_one_first: (1, 1, 0),
        an_array: (0, 1, 0),
        in_another_shape: (0, 0, 0),
        in_some_turns: (1, 0, 0),
        in_both_branches: (2, 1, 0),
        a_branch_with_another_array: (0, 0, 0),
        a_branch_that_shows_the_sum: (2, 0, 0),
        in_a_scan: (1, 0, 1),
        from_zeros_in_a_scan: (1, 0, 1),
        from_ones_in_a_scan: (1, 1, 1),
        a_scan_that_shows_its_sums: (1, 1, 0),
        a_scan_that_reads_its_sums: (0, 1, 0),
        a_scan_that_is_read: (1, 1, 1),
        a_scan_with_a_branch_that_shows_its_sums: (1, 1, 0),
        a_scan_with_a_loop_that_looks_at_its_sums: (1, 1, 0),
        a_loop_that_looks_at_its_sums: (1, 0, 0),
        back_along_a_scan: (1, 0, 1),
        in_a_program: (1, 0, 0),
    }


NAMES = [turn.__name__ for turn in cases_of(None)]


def assert_same(results, expected):
    for result, right in zip(results, expected, strict=True):
        np.testing.assert_allclose(result, right, rtol=1e-11, atol=1e-12)


def both_of(name, width):
    """The loop around a turn with a scalar program and with a function of JAX, their arguments, and what is added."""
    network, w = layers(width)
    x = jnp.array([0.3, -1.2])
    (turn, counts), (plain, _) = (
        next((turn, counts) for turn, counts in cases_of(one).items() if turn.__name__ == name)
        for one in (scalarize(network, w, x), network)
    )
    return turned(turn), turned(plain), (w, x), counts


@pytest.mark.parametrize("name", NAMES)
def test_sums_are_those_of_jax(name, additions):
    function, plain, examples, counts = both_of(name, 40)
    assert_same(in_machine_code(function, *examples), plain(*examples))
    assert tuple(additions.values()) == counts


def test_rows_are_added_in_the_turns_where_their_factors_would_be_many(additions, monkeypatch):
    function, plain, examples, _ = both_of("back_along_a_scan", 40)
    monkeypatch.setattr(loops, "LARGEST_DEFERRED", 3)
    assert_same(in_machine_code(function, *examples), plain(*examples))
    assert tuple(additions.values()) == (1, 0, 0)


def test_the_sum_of_thousands_of_derivatives(additions):
    """Of more than a loop changes in place as a rule; it is written once."""
    function, plain, examples, _ = both_of("back_along_a_scan", 64)
    assert_same(in_machine_code(function, *examples), plain(*examples))
    assert tuple(additions.values()) == (1, 0, 1)
