"""What JAX does not say of programs: whether one is traced now, and whether it calls Python."""

from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any

import jax
import jax.core
from jax.extend import core as jex

from spherejax.program_cache import private


def is_tracing() -> bool:
    """Whether a program is being traced: what is computed now, of numbers too, becomes a part of it."""
    # The cheapest operation that there is: 5 us, where `jnp.zeros` takes 40. JAX's own `trace_ctx` is deprecated.
    return not private.is_outside_of_transformations() and isinstance(
        jax.lax.stop_gradient(_a_number()), jax.core.Tracer
    )


@cache
def _a_number() -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jax.numpy.zeros(())


def calls_python(jaxpr: Any) -> bool:
    """Whether a traced program calls Python when it runs, as no other process could."""
    # By names and attributes: JAX has no public question for it, and a program that is written by mistake would call an
    # address of another process.
    return any(
        "callback" in equation.primitive.name  # pure_callback, io_callback, debug_callback
        or any(getattr(value, "calls_python", False) for value in equation.params.values())  # operations of our own
        or any(map(calls_python, _programs_in(equation.params.values())))
        for equation in jaxpr.eqns
    )


def _programs_in(parameters: Iterable) -> Iterator[Any]:
    """Those within an operation: the branches of a condition, the body of a loop."""
    for value in parameters:
        if isinstance(value, tuple | list):
            yield from _programs_in(value)
        elif isinstance(value, jex.ClosedJaxpr | jex.Jaxpr):
            yield value.jaxpr if isinstance(value, jex.ClosedJaxpr) else value
