"""The option of XLA that lets one kernel have several results: who gets it, and that no process ends by it."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxlib import xla_client

from spherejax.compiler import private, scalarize, several_results

NUMBERS = jnp.linspace(-1.0, 1.0, 40)


def highest(y):
    return NUMBERS[jnp.argmax(NUMBERS * jnp.sin(y))] * y


def lowest(y):
    return NUMBERS[jnp.argmin(NUMBERS * y)]


def n_reductions(function):
    module = jax.jit(function).lower(1.0).compiler_ir("stablehlo")
    assert module is not None
    with module.context:
        return several_results._n_reductions_of_pairs(module)


@pytest.mark.parametrize(
    ("function", "n"),
    [
        (jnp.sin, 0),
        (lambda y: jnp.max(NUMBERS * y) + jnp.sum(NUMBERS), 0),
        (highest, 1),
        (lambda y: highest(y) + lowest(y), 2),
        (lambda y: highest(y) + highest(jnp.cos(y)), 2),  # one function, called twice
        (lambda y: jax.lax.cond(y > 0, highest, lowest, y), 1),
        (lambda y: highest(y) + jax.lax.cond(y > 0, jnp.sin, lowest, y), 2),
        (
            lambda y: highest(y) + jax.lax.fori_loop(0, 1, lambda _, z: lowest(z), y),
            2,
        ),  # XLA may take it out of its loop
    ],
)
def test_reductions_of_pairs_are_counted(function, n):
    assert n_reductions(function) == n


@pytest.fixture
def given(monkeypatch):
    """The options of programs that are compiled, with the one that they are given."""
    seen = []
    added = private.with_backend_option

    def noted(options, name):
        made = added(options, name)
        if made is not options:
            seen.append(made.SerializeAsString())
        return made

    monkeypatch.setattr(private, "with_backend_option", noted)
    return seen


@pytest.mark.parametrize(
    ("beside", "is_given"),
    [(jnp.sin, True), (highest, True), (lambda y: highest(y) + lowest(y), False)],
)
def test_programs_with_a_scalar_program_have_the_option(given, beside, is_given):
    inner = scalarize(lambda y: jnp.stack([jnp.sin(y) * jnp.exp(y), jnp.cos(y) * jnp.exp(y)]), 1.0)

    new = np.random.default_rng().random() * 1e-3  # a program that no cache has

    def looped(y):
        return jax.lax.fori_loop(0, 5, lambda _, z: jnp.sum(inner(z)) * new + beside(z), y)

    assert jnp.isfinite(jax.jit(looped)(1.0))
    assert any(several_results.OPTION.encode() in options for options in given) == is_given


def test_programs_of_others_are_left_alone(given):
    assert jnp.isfinite(jax.jit(lambda y: jnp.sin(y) + highest(y))(1.0))
    assert not given


def test_an_option_is_added_to_those_that_a_program_has():
    options = xla_client.CompileOptions()
    options.num_replicas = 3
    options.executable_build_options.debug_options.xla_backend_optimization_level = 1
    more = private.with_backend_option(options, "xla_one")
    both = private.with_backend_option(more, "xla_two")
    assert (more.num_replicas, both.num_replicas) == (3, 3)
    assert both.executable_build_options.debug_options.xla_backend_optimization_level == 1
    assert b"xla_one" in both.SerializeAsString()
    assert b"xla_two" in both.SerializeAsString()
    assert b"xla_one" not in options.SerializeAsString()
    assert private.with_backend_option("no options", "xla_one") == "no options"


def test_options_that_jaxlib_does_not_read_stay_as_they_are(monkeypatch):
    options = xla_client.CompileOptions()
    monkeypatch.setattr(private, "_of_any_length", lambda number: b"\xff")
    assert private.with_backend_option(options, "xla_one") is options


def test_without_the_function_of_jax_nothing_is_wrapped(monkeypatch):
    monkeypatch.setattr(private, "COMPILING", ("no_such_name",))
    assert not private.wrap_compilation(lambda function: function)


def test_a_program_of_a_form_that_is_not_known_goes_without(monkeypatch):
    def unknown(module):
        raise KeyError("main")

    module = jax.jit(scalarize(lambda y: jnp.stack([jnp.sin(y), jnp.cos(y)]), 1.0)).lower(1.0).compiler_ir("stablehlo")
    assert several_results._needs(module)
    monkeypatch.setattr(several_results, "_n_reductions_of_pairs", unknown)
    assert not several_results._needs(module)


LOOP_OF_A_USER = """
import spherejax, jax, jax.numpy as jnp
from spherejax.compiler import scalarize
x = jnp.arange(40.0)
program = scalarize(lambda y: jnp.stack([jnp.sin(y) * jnp.exp(y), jnp.cos(y) * jnp.exp(y)]), 1.0)
def body(i, y):
    return x[jnp.argmax(x * jnp.sin(y))] * y + x[jnp.argmin(x * y)]
print(jax.jit(lambda y: jax.lax.fori_loop(0, 5, body, y))(1.0))
print(jax.jit(lambda y: jax.lax.fori_loop(0, 5, lambda i, y: body(i, y) + jnp.sum(program(y * 1e-3)), y))(1.0))
"""


def test_no_process_ends_over_loops_with_argmax_and_argmin():
    """XLA (jaxlib 0.10) ends one that compiles such a loop with the option."""
    done = subprocess.run([sys.executable, "-c", LOOP_OF_A_USER], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert all(abs(float(line)) < float("inf") for line in done.stdout.split())
