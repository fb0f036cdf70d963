"""What a value must satisfy, stated beside the class that owns it, judged in one place.

A law or a joint lists its `Requirement`s. When a scene is compiled, values that are concrete are judged at once
and a violated requirement raises a `SceneError` that names the place; values that are traced (inside `jit`,
`vmap`, `grad`) are judged inside the program and turn into the status of that lane.
"""

import re
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from spherejax.foundations.errors import SceneError

jax_core: Any = import_module("jax._src.core")


@contextmanager
def exits_as_errors() -> Iterator[None]:
    """`SystemExit` of a law or a force, as an error: it would end the user's process, and say neither why nor where."""
    try:
        yield
    except SystemExit as stop:
        at = traceback.extract_tb(stop.__traceback__)[-1]
        said = f"{at.filename}:{at.lineno}: SystemExit: {stop.code}, in {at.name}, which is a part of what is computed"
        raise RuntimeError(said).with_traceback(stop.__traceback__) from stop


class Requirement(NamedTuple):
    """One condition on one value.

    Attributes:
        field: the name of the value, as the user wrote it, e.g. `"restitution"`.
        value: the value itself: a number or an array, concrete or traced.
        satisfied: whether the condition holds, elementwise; NaN must count as violated
            (write `x > 0`, never `~(x <= 0)`).
        expected: what is expected, completing "must ...", e.g. `"lie in (0, 1]"`.
        remedy: what to do, one sentence.
    """

    field: str
    value: object
    satisfied: object
    expected: str
    remedy: str


def is_concrete(value) -> bool:
    """Whether `value` holds numbers that Python can look at now (no tracer)."""
    return not isinstance(value, jax.core.Tracer)


def is_tracing() -> bool:
    """Whether a program is being traced: what is computed now, of numbers too, becomes a part of it."""
    # The cheapest operation that there is: 5 us, where `jnp.zeros` takes 40, and 25 us within `jax.grad`.
    return not _is_outside_of_programs() and not is_concrete(jax.lax.stop_gradient(_a_number()))


def _is_outside_of_programs() -> bool:
    """Whether nothing but `jvp`, `grad` and `vmap` is under way; False where JAX, whose names are private, hides it."""
    trace: Any = getattr(getattr(jax_core, "trace_ctx", None), "trace", None)
    while type(trace).__name__ in ("JVPTrace", "LinearizeTrace", "BatchTrace"):
        trace = getattr(trace, "parent_trace", None)
    return type(trace).__name__ == "EvalTrace"


@cache
def _a_number() -> jax.Array:
    with jax.ensure_compile_time_eval():
        return jnp.zeros(())


def enforce(place: str, requirements: Iterable[Requirement]) -> list[Bool[Array, ""]]:
    """Raise `SceneError` for the first violated concrete requirement; return the traced conditions.

    Args:
        place: where the values live in the scene, e.g. `"joint 'coupler_rocker', normal law Hertz"`.
        requirements: the conditions.

    Returns:
        One boolean scalar for each requirement that depends on a traced value.
    """
    traced = []
    for requirement in requirements:
        if not is_concrete(requirement.satisfied):
            traced.append(jnp.all(jnp.asarray(requirement.satisfied)))
        elif not np.all(np.asarray(requirement.satisfied)):
            raise SceneError(
                f"{place}: {requirement.field} = {shown(requirement.value)} must {requirement.expected}. "
                f"{requirement.remedy}"
            )
    return traced


_NUMPYS = re.compile(r"np\.float64\(([^()]*)\)")
"""How a number is printed in a part of a scene, where it is one of NumPy."""


def shown(value) -> str:
    """A value for a message, not too long."""
    if not is_concrete(value):
        return "(traced)"
    try:
        array = np.asarray(value)
        if array.dtype.kind in "fiu":
            return f"{array.item():.6g}" if array.ndim == 0 else np.array2string(array, precision=6, threshold=12)
        text = _NUMPYS.sub(r"\1", repr(value))
    except (ValueError, TypeError, OverflowError):  # rows of different lengths; integers of thousands of digits
        text = "a number of thousands of digits" if isinstance(value, int) else repr(value)
    return text if len(text) < 80 else f"{text[:77]}..."


def concretely(function, *arguments):
    """`function(*arguments)`, evaluated now, as NumPy, when nothing in the arguments is traced.

    Inside an outer `jit` every JAX operation is staged, concrete operands or not; what could be known at once would
    be lost to the checks, and to the folding of structural zeros.
    """
    if not all(is_concrete(leaf) for leaf in jax.tree.leaves(arguments)):
        return function(*arguments)
    with jax.ensure_compile_time_eval():
        return jax.tree.map(np.asarray, function(*arguments))


def called(part: Any, method: str, *arguments: Any) -> Any:
    """A method of a part of a scene, without the bound method that equinox makes of it.

    That is a pytree of the part, made anew at each access: eighty of them took a quarter of the time of a call of
    `simulate` that is compiled.
    """
    return getattr(type(part), method)(part, *arguments)
