"""Derivatives of scalar programs as scalar programs: forward along tangents, and back through what is linear.

The derivative of a graph along tangents of its arguments is a graph that is linear in the tangents. Its coefficients
depend on the arguments alone: factors of products, reciprocals of divisors, slopes of functions. What the value has
computed is used again, and a coefficient is computed once however many tangents there are.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from typing import Any

import jax
import numpy as np

from spherejax.compiler.graph import Graph, by_jax
from spherejax.compiler.operations import FLOAT, OPERATIONS, NotScalarizable
from spherejax.compiler.trace import Interpreter


class Forward:
    """The derivative of a graph along tangents of some of its nodes.

    Attributes:
        values: the graph, with the coefficients added.
        slopes: a graph of derivatives; its inputs are the tangents, and nodes `"residual"` stand for coefficients.
        residuals: the node of `slopes` for each coefficient, a node of `values`.
    """

    def __init__(
        self,
        graph: Graph,
        nodes: Sequence[int],
        tangents: Mapping[int, tuple[int, int]],
        inactive: Collection[int] = (),
        read_from: Mapping[int, tuple[int, int]] | None = None,
    ):
        """Make the derivative.

        Args:
            graph: the nodes.
            nodes: those that are needed, in an order of evaluation; with the slopes of each `custom_jvp_node`.
            tangents: of what moves, the input of `slopes` that is its tangent.

        Other args:
            inactive: nodes whose values are arguments; they do not move with what they depend on.
            read_from: for nodes that are entries of arguments, inputs of `slopes` that are the same entries.
        """
        self._read_from = read_from or {}
        self.values, self.slopes = graph.copy(), Graph()
        self.residuals: dict[int, int] = {}
        self._of: dict[int, int] = {node: self.slopes.input(place) for node, place in tangents.items()}
        self._linear: set[int] = set()
        for node in nodes:
            if graph.operations[node] == "tangent" or any(a in self._linear for a in graph.arguments[node]):
                self._linear.add(node)
            if node not in self._of and node not in inactive:
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
        nodes = self.slopes.needed(outputs)
        if any(self.slopes.operations[node] == "refused" for node in nodes):
            raise NotScalarizable("a derivative of so high an order through a function with jax.custom_jvp")
        return nodes

    def _slope(self, node: int) -> int | None:
        graph, operation = self.values, self.values.operations[node]
        arguments = graph.arguments[node]
        if operation == "tangent":
            # A rule is written for any tangents of its arguments; here they are those of this derivative.
            return self._of.get(arguments[0])
        if operation == "custom_jvp_node":
            slope = graph.parameters[node]
            if slope is None and node in self._linear:  # what is linear is its own derivative, whichever rule it has
                slope = arguments[0]
            return self.slopes.node("refused", (), FLOAT) if slope is None else self._of.get(slope)
        # What is linear in tangents is followed along these: all else in it are its coefficients.
        along = self._linear if node in self._linear else None
        moving = [self._of.get(a) if along is None or a in along else None for a in arguments]
        if graph.dtypes[node] != FLOAT or all(slope is None for slope in moving):
            return None
        if (rule := OPERATIONS[operation].derivative) is not None:
            return rule(self, node, arguments, moving)
        # Functions without a rule of their own: the sum over arguments of partial derivative times tangent.
        parts = [self.times(self._partial(node, i), slope) for i, slope in enumerate(moving) if slope is not None]
        return self.sum(*parts)

    # What rules of `operations` are written with ----------------------------------------------------------------------

    def sum(self, first: int | None, *others: int | None) -> int | None:
        """A node of `slopes`; None stands for a structural zero."""
        total = first
        for slope in others:
            total = slope if total is None else total if slope is None else self.slopes.add(total, slope)
        return total

    def times(self, coefficient: int, slope: int | None) -> int | None:
        """A coefficient, a node of `values`, times a tangent; None for a structural zero, as everywhere in a graph."""
        if slope is None or self.values.is_value(coefficient, 0):
            return None
        # A product of the linear program: one for each tangent, where the coefficient is computed once for all.
        return self.slopes.mul(self.coefficient(coefficient), slope)

    def coefficient(self, node: int) -> int:
        """The node of `slopes` that stands for a node of `values`."""
        if self.values.is_constant(node):  # it folds in the linear program as well
            return self.slopes.constant(self.values.value(node), self.values.dtypes[node])
        if node in self._read_from:
            return self.slopes.input(self._read_from[node])
        if node not in self.residuals:
            self.residuals[node] = self.slopes.node("residual", (), self.values.dtypes[node], node)
        return self.residuals[node]

    def _partial(self, node: int, by: int) -> int:
        """The node of `values` for the derivative of an operation by one of its arguments."""
        graph, operation = self.values, self.values.operations[node]
        dtypes = tuple(graph.dtypes[a] for a in graph.arguments[node])
        closed = _slope_program(operation, graph.parameters[node], dtypes, by)
        names = [np.array(a, np.int64) for a in graph.arguments[node]]
        (partial,) = Interpreter(graph).run(closed.jaxpr, closed.consts, names)
        return int(partial)


# Kept, because a program has the same function at many nodes, and tracing is what a derivative spends its time with.
@lru_cache(maxsize=256)
def _slope_program(operation: str, parameters: Any, dtypes: tuple, by: int) -> Any:
    """The derivative of an operation by one of its arguments, as its record or else JAX has it."""
    partials, evaluate = OPERATIONS[operation].partials, by_jax(operation, parameters)

    def slope(*numbers):
        if partials is not None:
            return partials[by](*numbers)

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
        inactive: Collection[int],
        outputs: Mapping[int, Sequence[tuple[int, int]]],
    ):
        """Add the transpose.

        Args:
            graph: the nodes; nodes are added to it.
            nodes: those that are needed, in an order of evaluation.
            moving: what it is linear in.
            inactive: nodes whose values are arguments; they do not move with what they depend on.
            outputs: for the nodes that are returned, the inputs that are the numbers along them.

        Raises:
            NotScalarizable: for an operation that is not linear in what moves.
        """
        self.graph = graph
        self._along: dict[int, int] = {}
        # A transpose exists of what depends on the linear arguments; all else are coefficients of it.
        depends = set(moving)
        for node in nodes:
            if node not in inactive and any(a in depends for a in graph.arguments[node]):
                depends.add(node)
        for node, places in outputs.items():
            for place in places:
                self._add(node, graph.input(place))
        # Backwards: when a node's turn comes, all that reads it has passed its number on.
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
        rule = OPERATIONS[operation].transpose
        parts = None if rule is None else rule(graph, along, arguments, moves)
        if parts is None:
            raise NotScalarizable(f"the transpose of {operation!r}")
        for argument, part, counts in zip(arguments, parts, moves, strict=True):
            if counts:
                self._add(argument, part)
