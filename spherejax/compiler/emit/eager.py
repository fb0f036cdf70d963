"""A scalar program evaluated with Python numbers, at once: a compilation takes a second, this some milliseconds."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spherejax.compiler.graph import Graph
from spherejax.compiler.operations import INT, OPERATIONS

_NONE, _ALL = -1, -2
"""In place of an argument: there is none; the function takes all values."""


class EagerEvaluator:
    """The outputs of a graph, evaluated by a list of steps, which is made once: to go through the graph takes longer.

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
            if operation == "custom_jvp_node":  # has the value of its argument
                place[node] = arguments[0]
                continue
            place[node] = at = len(self._begin)
            self._begin.append(graph.value(node).item() if operation == "constant" else None)
            if operation == "input":
                self._inputs.append((at, *graph.parameters[node]))
            elif operation != "constant":
                # Of whole numbers Python's results are others: 7 / 2 is 3.5, and sums do not wrap.
                has_whole = any(graph.dtypes[a] == INT for a in graph.arguments[node])
                record = OPERATIONS[operation]
                python = None if has_whole and not record.takes_whole else record.python
                function = python or _evaluated_by(graph, node)
                # One or two arguments are passed without a list, which would have to be made in every call.
                if len(arguments) > 2:
                    self._steps.append((at, _of_all(function, arguments), _ALL, _NONE))
                else:
                    a, b = [*arguments, _NONE][:2]
                    self._steps.append((at, function, a, b))
        self._outputs = [place[node] for node in outputs]

    def __call__(self, entries: Sequence[Sequence[float]]) -> list:
        """The outputs, from the entries of each argument."""
        values = self._begin.copy()  # with the constants, which no step writes
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
        # Of the types of the nodes: a float of Python does not say whether it stands for a whole number.
        operands = [np.asarray(a, dtype) for a, dtype in zip(arguments, dtypes, strict=True)]
        return graph.evaluated(graph.operations[node], operands, graph.parameters[node]).item()

    return evaluated
