"""A straight-line program on scalars: nodes, with folding of constants and shared subexpressions.

A node is an operation on earlier nodes. Building a node folds what is known: constants, sums with 0, products with
0 and 1, powers with the exponents 1/2, 1, 3/2 and 2; a node that exists already is used again. A structural
zero times x is 0: the program presumes finite numbers there, as the array program would for a matrix that stores
no zeros.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from spherejax.compiler.operations import FLOAT, INT, OPERATIONS, NotScalarizable


class TooManyOperations(NotScalarizable):
    """The scalar program of the function would be larger than allowed."""

    is_too_large = True


class Graph:
    """Nodes of a scalar program under construction; a node is named by its index.

    Attributes:
        operations: the name of the operation of each node, in `operations.OPERATIONS`; or `"constant"`, `"input"`, or
            `"tangent"`, which nothing but a slope depends on.
        arguments: the earlier nodes that each node reads.
        parameters: a constant's value, an input's position, the slope of a `custom_jvp_node`, or a primitive's
            parameters.
        dtypes: the NumPy dtype of each node.
    """

    def __init__(self):
        self.operations: list[str] = []
        self.arguments: list[tuple[int, ...]] = []
        self.parameters: list = []
        self.dtypes: list[np.dtype] = []
        self._known: dict = {}

    def __getstate__(self) -> dict[str, list]:
        """Without the register of nodes, which only serves to add some."""
        return {name: value for name, value in vars(self).items() if name != "_known"}

    def __setstate__(self, state: dict[str, list]) -> None:
        nodes = zip(state["operations"], state["arguments"], state["parameters"], state["dtypes"], strict=True)
        vars(self).update(state, _known={(o, a, p, d): index for index, (o, a, p, d) in enumerate(nodes)})

    def copy(self, arguments: Mapping[int, int] | None = None) -> "Graph":
        """A graph with the same nodes, to which others can be added.

        Args:
            arguments: the numbers of the arguments whose entries are inputs, where they have others in the new graph.
        """
        made = Graph()
        # Shallow copies: nodes are never changed, only added, and a graph has tens of thousands.
        vars(made).update({name: value.copy() for name, value in vars(self).items()})
        if arguments is not None:
            for node, operation in enumerate(made.operations):
                if operation == "input":
                    argument, entry = made.parameters[node]
                    made.parameters[node] = arguments[argument], entry
            # The register has the inputs under their old numbers.
            made.__setstate__(made.__getstate__())
        return made

    def node(self, operation, arguments: tuple[int, ...], dtype: np.dtype, parameters=None) -> int:
        """The node for an operation, made only if it does not exist yet."""
        # a + b and b + a are one node.
        if operation in _COMMUTATIVE and arguments[0] > arguments[1]:
            arguments = (arguments[1], arguments[0])
        # The type is part of it: 1.0, 1 and True are equal to Python.
        key = (operation, arguments, parameters, dtype)
        known = self._known.get(key)
        if known is not None:
            return known
        index = len(self.operations)
        self.operations.append(operation)
        self.arguments.append(arguments)
        self.parameters.append(parameters)
        self.dtypes.append(dtype)
        self._known[key] = index
        return index

    def constant(self, value, dtype: np.dtype) -> int:
        """The node of a constant; -0.0 counts as 0.0, so that zeros of either sign are one structural zero."""
        value = dtype.type(value)
        # Programs ask whether an entry is zero all the time, and never of which sign.
        if dtype == FLOAT and value == 0:
            value = dtype.type(0)
        # By its bits, for NaN is not equal to itself, and would be a new node each time.
        return self.node("constant", (), dtype, (value.tobytes(), value))

    def input(self, position: tuple[int, int]) -> int:
        """The node of one entry of one argument: `position = (argument, flat index)`."""
        return self.node("input", (), FLOAT, position)

    def tangent(self, node: int) -> int:
        """Stands for the tangent of a node in a slope (`custom_jvp_node`); a structural zero for what does not move."""
        if self.is_constant(node):
            return self.constant(0, FLOAT)
        return self.node("tangent", (node,), FLOAT)

    def custom_jvp_node(self, node: int, slope: int | None) -> int:
        """A node with a derivative of its own: one that is linear in tangents of others, `slope`; None is refused.

        Its value is the node's. Whoever differentiates the graph takes the slope, and does not look behind the node.
        """
        return node if self.is_constant(node) else self.node("custom_jvp_node", (node,), self.dtypes[node], slope)

    def parameters_of(self, node: int) -> Any:
        """The parameters of a node's primitive, as sorted pairs; None where it has none."""
        # A node with a derivative rule of its own has its slope there, which does not belong to the operation.
        return None if self.operations[node] == "custom_jvp_node" else self.parameters[node]

    def predicate_of(self, node: int) -> int:
        """The boolean node that an integer 0 or 1 was made from, or the node itself."""
        if self.operations[node] == "select" and self.dtypes[node] == INT:
            predicate, on_false, on_true = self.arguments[node]
            if self.is_value(on_false, 0) and self.is_value(on_true, 1):
                return predicate
        return node

    def is_constant(self, node: int) -> bool:
        """Whether the value of a node is known."""
        return self.operations[node] == "constant"

    def value(self, node: int):
        """The value of a constant node."""
        return self.parameters[node][1]

    def is_value(self, node: int, value) -> bool:
        """Whether a node is the constant `value`."""
        return self.is_constant(node) and bool(self.value(node) == value)

    # Operations ---------------------------------------------------------------------------------------------------

    def add(self, a: int, b: int) -> int:
        """a + b."""
        return _fold_add(self, a, b)

    def sub(self, a: int, b: int) -> int:
        """a - b."""
        return _fold_sub(self, a, b)

    def mul(self, a: int, b: int) -> int:
        """a * b; 0 when either is a structural zero."""
        return _fold_mul(self, a, b)

    def div(self, a: int, b: int) -> int:
        """a / b."""
        return _fold_div(self, a, b)

    def neg(self, a: int) -> int:
        """-a."""
        return _fold_neg(self, a)

    def select(self, predicate: int, on_false: int, on_true: int) -> int:
        """`on_true` where the predicate holds, else `on_false`."""
        return _fold_select(self, predicate, on_false, on_true)

    def integer_power(self, a: int, exponent: int) -> int:
        """a ** exponent for a Python integer, by repeated multiplication."""
        return _expand_power(self, a, y=exponent)

    def power(self, a: int, b: int) -> int:
        """a ** b for a >= 0."""
        return _fold_power(self, a, b)

    def apply(
        self, name: str, arguments: tuple[int, ...], dtype: np.dtype | None = None, parameters: Any = None
    ) -> int:
        """The node of an operation without folding; a constant when all its arguments are.

        Args:
            name: of the operation.
            arguments: nodes.
            dtype: of the result; None is that of the first argument.
            parameters: those of JAX's primitive, as sorted pairs; None where it has none.
        """
        dtype = self.dtypes[arguments[0]] if dtype is None else dtype
        if all(self.is_constant(a) for a in arguments):
            return self.constant(self.evaluated(name, [self.value(a) for a in arguments], parameters), dtype)
        return self.node(name, arguments, dtype, parameters)

    def evaluated(self, name: str, values: list, parameters: Any) -> np.ndarray:
        """An operation on known numbers: by NumPy where it has the same, for JAX compiles a program for each."""
        operation = OPERATIONS[name]
        if operation.numpy is not None:
            with np.errstate(all="ignore"):  # compiled code gives infinities and NaN without a word, too
                return np.asarray(operation.numpy(*values))
        with jax.ensure_compile_time_eval():  # a number, also where somebody traces
            return np.asarray(by_jax(name, parameters)(*map(np.asarray, values)))

    # Emission ---------------------------------------------------------------------------------------------------

    def needed(self, outputs: Sequence[int], known_nodes: Collection[int] = (), with_slopes: bool = False) -> list[int]:
        """The nodes that the outputs depend on, in an order in which they can be evaluated.

        Args:
            outputs: nodes.
            known_nodes: nodes whose values are known, so that what they depend on is not needed.
            with_slopes: with the slopes of nodes that have a derivative rule of their own, and what these depend on.
        """
        known_nodes = frozenset(known_nodes)
        # From the last node to the first: a node reads earlier ones alone, so that one pass finds all.
        is_needed = np.zeros(len(self.operations), bool)
        is_needed[list(outputs)] = True
        for index in range(len(self.operations) - 1, -1, -1):
            if is_needed[index] and index not in known_nodes:
                for argument in self.arguments[index]:
                    is_needed[argument] = True
                if with_slopes and self.operations[index] == "custom_jvp_node" and self.parameters[index] is not None:
                    is_needed[self.parameters[index]] = True
        return [int(index) for index in np.flatnonzero(is_needed)]

    def invariants(self, outputs: Sequence[int], leading: Collection[int]) -> list[int]:
        """The operations that depend on leading arguments alone, and are returned or read by those that depend on more.

        These are what can be evaluated once, ahead of a loop in which those arguments do not change.
        """
        is_invariant: dict[int, bool] = {}
        frontier = set()
        # In the order of evaluation: what a node reads has been looked at before.
        for index in self.needed(outputs):
            operation = self.operations[index]
            if operation == "input":
                is_invariant[index] = self.parameters[index][0] in leading
            else:
                is_invariant[index] = all(is_invariant[a] for a in self.arguments[index])
            if not is_invariant[index]:
                frontier.update(a for a in self.arguments[index] if is_invariant[a])
        frontier.update(index for index in outputs if is_invariant[index])
        return sorted(index for index in frontier if self.operations[index] not in ("constant", "input"))

    def count(self, outputs: Sequence[int], known_nodes: Collection[int] = ()) -> Counter:
        """How many operations of each name the outputs need (`FREE` and known nodes not counted)."""
        names = Counter()
        for index in self.needed(outputs, known_nodes):
            operation = self.operations[index]
            if operation not in FREE and index not in known_nodes:
                names[operation] += 1
        return names

    def emit(
        self,
        outputs: Sequence[int],
        read: Callable[[tuple[int, int]], jax.Array],
        known_values: Mapping[int, jax.Array] | None = None,
    ) -> dict[int, jax.Array]:
        """Evaluate the outputs with JAX scalars (or tracers); `read(position)` gives the inputs."""
        values: dict = dict(known_values or {})
        for index in self.needed(outputs, values.keys()):
            operation = self.operations[index]
            if index in values:
                continue
            if operation == "constant":
                values[index] = np.asarray(self.value(index), self.dtypes[index])
            elif operation == "input":
                values[index] = read(self.parameters[index])
            else:
                arguments = [values[a] for a in self.arguments[index]]
                values[index] = by_jax(operation, self.parameters_of(index))(*arguments)
        return values


FREE = frozenset({"constant", "input", "custom_jvp_node"})
"""Names of nodes that cost nothing."""

_COMMUTATIVE = frozenset(name for name, operation in OPERATIONS.items() if operation.commutes)


def _rule(name: str) -> Callable[..., int]:
    rule = OPERATIONS[name].folded
    assert rule is not None, name
    return rule


# Looked up once: a large program calls them a hundred thousand times.
_fold_add, _fold_sub, _fold_mul, _fold_div = _rule("add"), _rule("sub"), _rule("mul"), _rule("div")
_fold_neg, _fold_select, _fold_power, _expand_power = (
    _rule("neg"), _rule("select"), _rule("pow"), _rule("integer_pow")
)  # fmt: skip


def by_jax(name: str, parameters: Any) -> Callable[..., Any]:
    """An operation as a function of JAX; `parameters` as of a node."""
    function = OPERATIONS[name].jax
    assert function is not None, f"{name} is folded into others"
    return partial(function, **dict(parameters)) if parameters else function
