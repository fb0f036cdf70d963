"""When two values, and two calls, are the same to the program cache."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.program_cache import cached_jit
from spherejax.program_cache.keys import LruCache, call_key, lru_get, own_arrays, value_key

UNLIKE = {
    "int and bool": (1, True),
    "int and float": (1, 1.0),
    "signed zeros": (0.0, -0.0),
    "number and array": (1.0, np.asarray(1.0)),
    "types of arrays": (np.ones(2), np.ones(2, np.float32)),
    "shapes": (np.ones(2), np.ones((2, 1))),
    "one entry": (np.zeros(2), np.array([0.0, 1e-300])),
    "NumPy and JAX": (np.ones(2), jnp.ones(2)),
    "names": ({"a": 1.0}, {"b": 1.0}),
    "containers": ([1.0], (1.0,)),
}


@pytest.mark.parametrize("pair", UNLIKE.values(), ids=UNLIKE)
def test_values_that_are_not_the_same_have_other_keys(pair):
    first, second = map(value_key, pair)
    assert first is not None
    assert second is not None
    assert first != second


def test_equal_values_have_equal_keys():
    def tree():
        return {"a": [np.arange(3.0), 1, True, "name"], "b": (np.nan, None)}

    assert value_key(tree()) == value_key(tree())
    assert hash(value_key(tree())) == hash(value_key(tree()))


@pytest.mark.parametrize("leaf", [object(), np.array([None]), lambda: 1])
def test_what_cannot_be_compared_has_no_key(leaf):
    assert value_key({"a": leaf}) is None


def test_keys_of_random_numbers_have_no_key():
    """NumPy has no arrays of them: they raised a TypeError."""
    assert value_key({"a": jax.random.key(0)}) is None


def test_a_traced_value_has_no_key():
    seen = []
    jax.jit(lambda x: seen.append(value_key({"a": x})) or x)(1.0)
    assert seen == [None]


@pytest.mark.parametrize(("first", "second"), [(1, True), (1, 1.0), (0.0, -0.0)])
def test_static_numbers_that_python_calls_equal_are_other_programs(first, second):
    """To Python 1 == 1.0 == True; the second call was answered by the program of the first one."""

    @cached_jit
    def like(number, x):
        return x * jnp.copysign(2.0, number), type(number)

    for number in (first, second, first):
        scaled, kind = like(number, jnp.float64(3.0))
        assert kind is type(number)
        assert scaled == 3.0 * np.copysign(2.0, number)
    assert like.n_programs == 2


def test_nan_as_a_static_number_is_one_program():
    @cached_jit
    def doubled(x, number):
        return 2 * x

    for _ in range(3):
        doubled(jnp.ones(2), float("nan"))
    assert doubled.n_programs == 1


def test_calls_are_the_same_by_shapes_and_types_of_arrays():
    def key(*arguments):
        return call_key((arguments, {}))[0]

    assert key(np.zeros(3), "a") == key(np.ones(3), "a")
    assert key(np.zeros(3), "a") != key(np.zeros(3), "b")
    assert key(np.zeros(3)) != key(np.zeros(4))
    assert key(np.zeros(3)) != key(np.zeros(3, np.float32))
    assert key(jnp.asarray(1.0)) != key(jnp.float64(1.0) * 1)  # weak types promote differently
    with pytest.raises(TypeError, match="unhashable"):
        key(bytearray())


# Tables of bounded size -----------------------------------------------------------------------------------------------


def test_the_least_recently_used_entry_is_evicted():
    evicted, made = [], []
    table = LruCache(2, evicted=evicted.append)

    def get(key):
        return table.get(key, lambda: made.append(key) or key)

    for key in "abac":
        assert get(key) == key
    assert made == ["a", "b", "c"]
    assert evicted == ["b"]
    assert table.values() == ["a", "c"]
    table.clear()
    assert evicted == ["b", "a", "c"]
    assert len(table) == 0


def test_threads_get_the_entry_that_was_entered_first():
    table, both = LruCache(4), threading.Barrier(2, timeout=10)

    def made():
        both.wait()  # both threads are making the entry now
        return object()

    found = []
    threads = [threading.Thread(target=lambda: found.append(table.get("key", made))) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 2
    assert found[0] is found[1]


def test_nothing_is_entered_without_a_key_or_within_a_trace():
    table = LruCache(4)
    assert lru_get(table, None, lambda: 1) == 1

    @jax.jit
    def traced(x):
        return x + lru_get(table, "key", lambda: jnp.ones(()))

    assert traced(1.0) == 2.0
    assert len(table) == 0
    assert lru_get(table, "key", lambda: jnp.ones(())) == 1.0
    assert len(table) == 1
    assert traced(2.0) == 3.0


def test_a_copy_has_arrays_of_its_own():
    tree = {"numpy": np.zeros(2), "jax": jnp.zeros(2), "number": 1.0}
    copy = own_arrays(tree)
    copy["numpy"][0] = 1.0
    assert tree["numpy"][0] == 0.0
    assert copy["jax"] is tree["jax"]
