"""Between what the whole numbers of a graph surely lie: an index of a table or a branch, a count of what holds.

Whole numbers are computed with 64 bits, and JAX's often have 32. Where the limits of a number are within its own type
it cannot wrap around, and where they are within a table no bound needs to be written.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from spherejax.compiler.operations import BOOL, INT

Limits = tuple[int, int]

ANY_NUMBER: Limits = (-(2**63), 2**63 - 1)
"""Limits of a whole number of 64 bits."""


def limits_of(graph: Any, node: int, known: dict[int, Limits]) -> Limits:
    """The least and the largest number that a node may be.

    Args:
        graph: the nodes.
        node: a whole number.
        known: limits of nodes, which are added to.
    """
    # Without recursion: a count of a thousand truths is a thousand sums behind one another.
    waiting = [node]
    while waiting:
        if (last := waiting[-1]) not in known:
            missing = [argument for argument in _arguments(graph, last) if argument not in known]
            waiting += missing
            if missing:
                continue
            known[last] = _limits(graph, last, known)
        waiting.pop()
    return known[node]


def _arguments(graph: Any, node: int) -> tuple[int, ...]:
    """The numbers that the limits of a node follow from; none of one that may be any."""
    operation, arguments = graph.operations[node], graph.arguments[node]
    if operation in ("select", "lookup"):
        arguments = arguments[1:]
    is_known = operation in _WITH_LIMITS and all(graph.dtypes[argument] == INT for argument in arguments)
    return arguments if is_known else ()


def _limits(graph: Any, node: int, known: dict[int, Limits]) -> Limits:
    if graph.is_constant(node):
        return int(graph.value(node)), int(graph.value(node))
    if graph.dtypes[node] == BOOL:
        return 0, 1
    arguments = _arguments(graph, node)
    if not arguments:
        return ANY_NUMBER
    low, high = _WITH_LIMITS[graph.operations[node]](*(known[argument] for argument in arguments))
    # What is beyond 64 bits may have wrapped around to any number.
    return (low, high) if low >= ANY_NUMBER[0] and high <= ANY_NUMBER[1] else ANY_NUMBER


def _of_corners(function: Callable[[int, int], int]) -> Callable[..., Limits]:
    def limits(a: Limits, b: Limits) -> Limits:
        corners = [function(x, y) for x in a for y in b]
        return min(corners), max(corners)

    return limits


def _of_any(*cases: Limits) -> Limits:
    return min(low for low, _ in cases), max(high for _, high in cases)


def _of_quotient(a: Limits, b: Limits) -> Limits:
    """Cut towards zero, so no larger than the dividend; -1 where the divisor may be 0."""
    if b[0] > 0 and b[0] == b[1]:
        return tuple(sorted(abs(x) // b[0] * (1 if x >= 0 else -1) for x in a))  # type: ignore[return-value]
    size = max(map(abs, a))
    return min(-size, -1), size


def _of_remainder(a: Limits, b: Limits) -> Limits:
    """Of the sign of the dividend, and smaller than the divisor; the dividend itself where that is 0."""
    size = max(map(abs, a))
    if b[0] > 0 or b[1] < 0:
        size = min(size, max(map(abs, b)) - 1)
    return (-size if a[0] < 0 else 0), (size if a[1] > 0 else 0)


def _of_common_bits(a: Limits, b: Limits) -> Limits:
    """Of two numbers of which one is not negative, neither is what they have in common, and it is no larger."""
    bounds = [high for low, high in (a, b) if low >= 0]
    return (0, min(bounds)) if bounds else ANY_NUMBER


_WITH_LIMITS: dict[str, Callable[..., Limits]] = {
    "select": _of_any,
    "lookup": _of_any,
    "add": _of_corners(lambda x, y: x + y),
    "sub": _of_corners(lambda x, y: x - y),
    "mul": _of_corners(lambda x, y: x * y),
    "div": _of_quotient,
    "rem": _of_remainder,
    "and": _of_common_bits,
    "min": _of_corners(min),
    "max": _of_corners(max),
    "clamp": lambda low, x, high: (min(max(low[0], x[0]), high[0]), min(max(low[1], x[1]), high[1])),
    "neg": lambda one: (-one[1], -one[0]),
    "abs": lambda one: (max(one[0], -one[1], 0), max(map(abs, one))),
    "sign": lambda one: (int(np.sign(one[0])), int(np.sign(one[1]))),
}
