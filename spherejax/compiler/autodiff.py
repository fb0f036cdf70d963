"""Derivatives of scalar programs as scalar programs: forward along tangents, and back through what is linear.

The derivative of a graph along tangents of its arguments is a graph that is linear in the tangents. Its coefficients
depend on the arguments alone: factors of products, reciprocals of divisors, slopes of functions. What the value has
computed is used again, and a coefficient is computed once however many tangents there are.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import jax
import numpy as np

from spherejax.compiler.graph import EMIT, FLOAT, Graph, NotScalarizable
from spherejax.compiler.trace import Interpreter


class Forward:
    """The derivative of a graph along tangents of some of its nodes.

    Attributes:
        values: the graph, with the coefficients added.
        slopes: a graph of derivatives; its inputs are the tangents, and nodes `"given"` stand for coefficients.
        given: the node of `slopes` for each coefficient, a node of `values`.
    """

    def __init__(
        self, graph: Graph, nodes: Sequence[int], tangents: Mapping[int, tuple[int, int]], still: Collection[int] = ()
    ):
        """Make the derivative.

        Args:
            graph: the nodes.
            nodes: those that are needed, in an order of evaluation, with the slopes of marked nodes.
            tangents: of what moves, the input of `slopes` that is its tangent.

        Other args:
            still: nodes that are given, and do not move with what they depend on.
        """
        self.values, self.slopes = graph.copy(), Graph()
        self.given: dict[int, int] = {}
        self._of: dict[int, int] = {node: self.slopes.input(place) for node, place in tangents.items()}
        self._linear: set[int] = set()
        for node in nodes:
            if graph.operations[node] == "tangent" or any(a in self._linear for a in graph.arguments[node]):
                self._linear.add(node)
            if node not in self._of and node not in still:
                slope = self._slope(node)
                if slope is not None:
                    self._of[node] = slope

    def of(self, node: int) -> int | None:
        """The node of `slopes` for a node's derivative; None for what does not move."""
        return self._of.get(node)

    def needed(self, outputs: Sequence[int]) -> list[int]:
        """The nodes of `slopes` that these depend on.

        Raises:
            NotScalarizable: where a derivative is of higher order than rules are followed.
        """
        found = self.slopes.needed(outputs)
        if any(self.slopes.operations[node] == "refused" for node in found):
            raise NotScalarizable("a derivative of so high an order through a function with jax.custom_jvp")
        return found

    def _slope(self, node: int) -> int | None:
        graph, operation = self.values, self.values.operations[node]
        arguments = graph.arguments[node]
        if operation == "tangent":
            return self._of.get(arguments[0])
        if operation == "marked":
            slope = graph.parameters[node]
            if slope is None and node in self._linear:  # what is linear is its own derivative, whichever rule it has
                slope = arguments[0]
            return self.slopes.node("refused", (), FLOAT) if slope is None else self._of.get(slope)
        # What is linear in tangents is followed along these: all else in it are its coefficients.
        along = self._linear if node in self._linear else None
        moving = [self._of.get(a) if along is None or a in along else None for a in arguments]
        if graph.dtypes[node] != FLOAT or all(slope is None for slope in moving):
            return None
        rule = _RULES.get(operation) if isinstance(operation, str) else None
        if rule is not None:
            return rule(self, node, arguments, moving)
        parts = [self._times(self._partial(node, i), slope) for i, slope in enumerate(moving) if slope is not None]
        return self._sum(*parts)

    def _sum(self, first: int | None, *others: int | None) -> int | None:
        total = first
        for each in others:
            total = each if total is None else total if each is None else self.slopes.add(total, each)
        return total

    def _times(self, coefficient: int, slope: int | None) -> int | None:
        """Nothing for a structural zero, as everywhere in a graph."""
        if slope is None or self.values.is_value(coefficient, 0):
            return None
        return self.slopes.mul(self._given(coefficient), slope)

    def _given(self, node: int) -> int:
        if self.values.is_constant(node):
            return self.slopes.constant(self.values.value(node), self.values.dtypes[node])
        if node not in self.given:
            self.given[node] = self.slopes.node("given", (), self.values.dtypes[node], node)
        return self.given[node]

    def _partial(self, node: int, by: int) -> int:
        """The node of `values` for the derivative of an operation by one of its arguments."""
        graph, operation = self.values, self.values.operations[node]
        dtypes = tuple(graph.dtypes[a] for a in graph.arguments[node])
        closed = _slope_program(operation, graph.parameters[node], dtypes, by)
        names = [np.array(a, np.int64) for a in graph.arguments[node]]
        (found,) = Interpreter(graph).run(closed.jaxpr, closed.consts, names)
        return int(found)

    # Rules of operations that have names: what the value has computed serves for the derivative.

    def _add(self, node, arguments, moving):
        return self._sum(*moving)

    def _sub(self, node, arguments, moving):
        left, right = moving
        if right is None:
            return left
        return self.slopes.neg(right) if left is None else self.slopes.sub(left, right)

    def _neg(self, node, arguments, moving):
        return self.slopes.neg(moving[0])

    def _mul(self, node, arguments, moving):
        (a, b), (da, db) = arguments, moving
        if a == b:
            return self._times(self.values.add(a, a), da)
        return self._sum(self._times(b, da), self._times(a, db))

    def _div(self, node, arguments, moving):
        """(a / b)' = (a' - (a / b) b') / b."""
        b, (da, db) = arguments[1], moving
        change = None if db is None else self._times(node, db)
        if change is not None:
            da = self.slopes.neg(change) if da is None else self.slopes.sub(da, change)
        return self._times(self.values.div(self.values.constant(1, FLOAT), b), da)

    def _sqrt(self, node, arguments, moving):
        return self._times(self.values.div(self.values.constant(0.5, FLOAT), node), moving[0])

    def _select(self, node, arguments, moving):
        zero = self.slopes.constant(0, FLOAT)
        on_false, on_true = (zero if slope is None else slope for slope in moving[1:])
        if on_false == on_true == zero:
            return None
        return self.slopes.select(self._given(arguments[0]), on_false, on_true)


_RULES: dict[str, Callable] = {
    "add": Forward._add,
    "sub": Forward._sub,
    "neg": Forward._neg,
    "mul": Forward._mul,
    "div": Forward._div,
    "sqrt": Forward._sqrt,
    "select": Forward._select,
}


_OF_ERF = 2.0 / np.sqrt(np.pi)

_SLOPES = {"erf": lambda x: _OF_ERF * jax.lax.exp(-x * x), "erfc": lambda x: -_OF_ERF * jax.lax.exp(-x * x)}
"""Derivatives that JAX takes by the bits of a number (since 0.11), which scalar programs do not know."""


@lru_cache(maxsize=256)
def _slope_program(operation: Any, parameters: Any, dtypes: tuple, by: int) -> Any:
    """The derivative of an operation by one of its arguments, as JAX has it."""
    if slope_of_it := _SLOPES.get(getattr(operation, "name", "")):
        return jax.make_jaxpr(slope_of_it)(jax.ShapeDtypeStruct((), FLOAT))
    evaluate: Any = EMIT[operation] if isinstance(operation, str) else partial(operation.bind, **dict(parameters))

    def slope(*numbers):
        def of_one(x):
            return evaluate(*numbers[:by], x, *numbers[by + 1 :])

        return jax.jvp(of_one, (numbers[by],), (np.ones((), FLOAT),))[1]

    return jax.make_jaxpr(slope)(*(jax.ShapeDtypeStruct((), dtype) for dtype in dtypes))


class Transposed:
    """The transpose of a graph that is linear in some of its nodes: from numbers along its outputs back to these.

    Attributes:
        graph: the graph, with the transpose added.
    """

    def __init__(
        self,
        graph: Graph,
        nodes: Sequence[int],
        moving: Collection[int],
        still: Collection[int],
        outputs: Mapping[int, Sequence[tuple[int, int]]],
    ):
        """Add the transpose.

        Args:
            graph: the nodes; nodes are added to it.
            nodes: those that are needed, in an order of evaluation.
            moving: what it is linear in.
            still: nodes that are given, and do not move with what they depend on.
            outputs: for the nodes that are returned, the inputs that are the numbers along them.

        Raises:
            NotScalarizable: for an operation that is not linear in what moves.
        """
        self.graph = graph
        self._along: dict[int, int] = {}
        depends = set(moving)
        for node in nodes:
            if node not in still and any(a in depends for a in graph.arguments[node]):
                depends.add(node)
        for node, places in outputs.items():
            for place in places:
                self._add(node, graph.input(place))
        for node in reversed(nodes):
            if node in depends and node not in moving and node in self._along:
                self._pass_on(node, self._along[node], depends)

    def along(self, node: int | None) -> int:
        """The node for the number along a node that moves; None is one that nothing depends on."""
        return self._along.get(-1 if node is None else node, self.graph.constant(0, FLOAT))

    def _add(self, node: int, part: int) -> None:
        self._along[node] = part if node not in self._along else self.graph.add(self._along[node], part)

    def _pass_on(self, node: int, along: int, depends: set[int]) -> None:
        graph, operation, arguments = self.graph, self.graph.operations[node], self.graph.arguments[node]
        moves = [a in depends for a in arguments]
        if operation == "add":
            parts = [along, along]
        elif operation == "sub":
            parts = [along, graph.neg(along)]
        elif operation == "neg":
            parts = [graph.neg(along)]
        elif operation == "marked":  # what is linear is its own derivative, whichever rule it has
            parts = [along]
        elif operation == "mul" and not all(moves):
            parts = [graph.mul(along, arguments[1]), graph.mul(along, arguments[0])]
        elif operation == "div" and not moves[1]:
            parts = [graph.div(along, arguments[1]), along]
        elif operation == "select" and not moves[0]:
            zero = graph.constant(0, FLOAT)
            parts = [along, graph.select(arguments[0], along, zero), graph.select(arguments[0], zero, along)]
        else:
            raise NotScalarizable(f"the transpose of {operation!r}")
        for argument, part, counts in zip(arguments, parts, moves, strict=True):
            if counts:
                self._add(argument, part)
