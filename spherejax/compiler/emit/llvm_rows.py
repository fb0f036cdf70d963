"""Many uses of one function in a straight line, none of which waits for another, as functions of vectors.

A layer of a network is 64 times tanh. The level of a node is the number of functions on the longest way to it from the
arguments. Uses of one function at one level need none of each other, and are one row. The line is written in another
order then: first what needs no function, then the functions of level 1, then what needs no others, and so on.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from spherejax.compiler.emit.llvm_functions import FUNCTIONS
from spherejax.compiler.operations import OPERATIONS

VECTORS = {name for name, operation in OPERATIONS.items() if operation.library in FUNCTIONS} | {"logistic"}
"""Operations that vectors have functions for."""

SHORTEST = 8
"""Uses of a function in a row, at least. Mechanisms have a few here and there, for which a line is not written in
another order: all that comes before the functions would have to wait in memory for what comes behind them."""

SMALLEST_REST = 3
"""Uses that are a vector behind whole ones, at least: it takes twice as long as a number."""


class FunctionRows(NamedTuple):
    """What is written as functions of vectors.

    Attributes:
        order: of the nodes of the line.
        rows: by their first node, all nodes of a vector.
    """

    order: tuple[int, ...]
    rows: dict[int, tuple[int, ...]]


def rows_of(line: Any, is_written: Callable[[int], bool], width: int) -> FunctionRows | None:
    """The rows of a line; None where there are none.

    Args:
        line: what is evaluated.
        is_written: whether a node is an operation, and no argument.
        width: numbers in a vector, at most.
    """
    graph = line.graph
    level: dict[int, int] = {}
    together: dict[tuple[int, str], list[int]] = {}
    for node in line.nodes:
        operation = graph.operations[node]
        level[node] = max((level[a] for a in graph.arguments[node]), default=0) if is_written(node) else 0
        if is_written(node) and operation in VECTORS:
            level[node] += 1
            together.setdefault((level[node], operation), []).append(node)
    rows: dict[int, tuple[int, ...]] = {}
    for nodes in together.values():
        if len(nodes) >= SHORTEST:
            rows |= {row[0]: row for row in _vectors(nodes, width)}
    if not rows:
        return None
    uses = {node for nodes in together.values() for node in nodes}
    order = sorted(line.nodes, key=lambda node: (level[node], node not in uses))  # otherwise as they were
    return FunctionRows(tuple(order), rows)


def _vectors(nodes: Sequence[int], width: int) -> list[tuple[int, ...]]:
    every = [tuple(nodes[at : at + width]) for at in range(0, len(nodes), width)]
    return [row for row in every if len(row) >= SMALLEST_REST]
