"""Many uses of a function in a line as functions of vectors: the bits of single numbers, whatever waits for what."""

import re
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from spherejax.compiler import native_code, primitive, scalarize
from spherejax.compiler.emit import llvm_rows
from spherejax.compiler.emit.llvm import FunctionText


@pytest.fixture(autouse=True)
def on(monkeypatch):
    """In programs of any size."""
    monkeypatch.setattr(primitive, "SMALLEST_CALLED", 0)
    with native_code():
        if not native_code.is_enabled():
            pytest.skip("no machine code with this jaxlib, or without llvmlite")
        yield


def numbers(*shape, seed=0):
    return jnp.asarray(np.random.default_rng(seed).uniform(-1.0, 1.0, shape))


def calls(function, *examples) -> Counter[str]:
    """How often its text calls which function of how many numbers."""
    line = scalarize(function, *examples).line_called()
    text = FunctionText(line, (), (0,) * (len(line.shapes) + len(line.residuals))).written()
    return Counter(re.findall(r"call [^@]*@spherejax\.(\w+\.\d)\(", text))


def two_layers(x):
    inner = jnp.tanh(jnp.roll(x, 3) + 0.5 * x)
    return jnp.tanh(inner * jnp.sum(inner) + x[::-1])


def mixed(x):
    """Some wait for others of their kind, some for those of another one."""
    low = jnp.tanh(x[:8])
    return jnp.concatenate([jnp.exp(low) * jnp.tanh(x[8:16]), jnp.tanh(low[::-1] + x[8:16]), jnp.expm1(low[:3])])


CASES = {
    "one row": (jnp.tanh, 16, {"tanh.8": 2}),
    "a vector that is filled up": (jnp.tanh, 11, {"tanh.8": 1, "tanh.4": 1}),
    "two numbers behind a vector": (jnp.expm1, 10, {"expm1.8": 1, "expm1.1": 2}),
    "too few": (jnp.tanh, 7, {"tanh.1": 7}),
    "by another function": (jax.nn.sigmoid, 9, {"exp.8": 1, "exp.1": 1}),
    "two layers": (two_layers, 20, {"tanh.8": 4, "tanh.4": 2}),
    "mixed": (mixed, 16, {"tanh.8": 3, "exp.8": 1, "expm1.1": 3}),
    "one behind the other": (lambda x: jnp.stack([jnp.tanh(x[0]), jnp.tanh(jnp.tanh(x[1]))]), 2, {"tanh.1": 3}),
}


@pytest.mark.parametrize("name", CASES)
def test_vectors_are_called_and_give_the_bits_of_numbers(name, monkeypatch):
    function, n, expected = CASES[name]
    x = numbers(n)
    assert calls(function, x) == expected
    result = jax.jit(scalarize(function, x))(x)
    monkeypatch.setattr(llvm_rows, "SHORTEST", n + 100)
    assert {word.split(".")[1] for word in calls(function, x)} == {"1"}
    np.testing.assert_array_equal(result, jax.jit(scalarize(function, x))(x))
    np.testing.assert_allclose(result, function(x), rtol=1e-14)


@pytest.mark.parametrize("name", ["two layers", "mixed"])
def test_derivatives(name):
    function, n, _ = CASES[name]
    x, along = numbers(n), numbers(n, seed=1)
    program = scalarize(function, x)
    slopes = jax.jit(lambda x: jax.jvp(program, (x,), (along,))[1])(x)
    np.testing.assert_allclose(slopes, jax.jvp(function, (x,), (along,))[1], rtol=1e-13)
    back = jax.jit(lambda x: jax.vjp(program, x)[1](slopes)[0])(x)
    np.testing.assert_allclose(back, jax.vjp(function, x)[1](slopes)[0], rtol=1e-12, atol=1e-15)


def test_runs_side_by_side_have_the_same_bits():
    x = numbers(5, 20)
    program = scalarize(two_layers, x[0])
    alone = jnp.stack([jax.jit(program)(one) for one in x])
    np.testing.assert_array_equal(jax.jit(jax.vmap(program))(x), alone)
