"""A scalar program evaluated with Python numbers, at once: a compilation takes a second, this some milliseconds."""

import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spherejax.compiler.graph import Graph

_NONE, _ALL = -1, -2
"""In place of an argument: there is none; the function takes all values."""


class NumbersNow:
    """The outputs of a graph, by a list of what is to be done, made once: to go through the graph takes longer.

    Args:
        graph: the nodes.
        outputs: what is wanted of them.
    """

    def __init__(self, graph: Graph, outputs: Sequence[int]):
        place: dict[int, int] = {}
        self._begin: list[Any] = []
        self._inputs: list[tuple[int, int, int]] = []
        self._steps: list[tuple[int, Callable, int, int]] = []
        for node in graph.needed(outputs):
            operation, arguments = graph.operations[node], [place[a] for a in graph.arguments[node]]
            if operation == "marked":
                place[node] = arguments[0]
                continue
            place[node] = at = len(self._begin)
            self._begin.append(graph.value(node).item() if operation == "constant" else None)
            if operation == "input":
                self._inputs.append((at, *graph.parameters[node]))
            elif operation != "constant":
                known = _COMPUTE.get(operation if isinstance(operation, str) else operation.name)
                function = known or _evaluated_by(graph, node)
                if len(arguments) > 2:
                    self._steps.append((at, _of_all(function, arguments), _ALL, _NONE))
                else:
                    a, b = [*arguments, _NONE][:2]
                    self._steps.append((at, function, a, b))
        self._outputs = [place[node] for node in outputs]

    def __call__(self, entries: Sequence[Sequence[float]]) -> list:
        """The outputs, from the entries of each argument."""
        values = self._begin.copy()
        for at, argument, entry in self._inputs:
            values[at] = entries[argument][entry]
        for at, function, a, b in self._steps:
            if b >= 0:
                values[at] = function(values[a], values[b])
            elif a >= 0:
                values[at] = function(values[a])
            else:
                values[at] = function(values)
        return [values[at] for at in self._outputs]


def _of_all(function: Callable, arguments: list[int]) -> Callable:
    return lambda values: function(*[values[a] for a in arguments])


def _evaluated_by(graph: Graph, node: int) -> Callable:
    """An operation that Python has no function for."""
    dtypes = [graph.dtypes[a] for a in graph.arguments[node]]

    def evaluated(*arguments: Any) -> Any:
        operands = [np.asarray(a, dtype) for a, dtype in zip(arguments, dtypes, strict=True)]
        return graph.evaluated(graph.operations[node], operands, graph.parameters[node]).item()

    return evaluated


def _root(a: float) -> float:
    return math.sqrt(a) if a >= 0 else math.nan


_COMPUTE: dict[str, Callable] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": lambda a, b: a / b if b else float(np.divide(a, b)),
    "neg": operator.neg,
    "pow": lambda a, b: float(np.power(a, b)),
    "sqrt": _root,
    "select": lambda predicate, on_false, on_true: on_true if predicate else on_false,
    "root_guarded_at_zero": _root,
    "sin": math.sin,
    "cos": math.cos,
    "atan2": math.atan2,
    "abs": abs,
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
}
