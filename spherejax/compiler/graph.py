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

from spherejax.compiler.operations import BOOL, FLOAT, INT, OPERATIONS, NotScalarizable
from spherejax.compiler.ranges import Limits, limits_of


class TooManyOperations(NotScalarizable):
    """The scalar program of the function would be larger than allowed."""

    is_too_large = True


LARGEST_TABLE = 4096
"""Entries of a table that is read at a computed place, at most: each is an argument of a node."""

MOST_CHOICES = 8
"""Selections by truths that a number is chosen by and that are made again for each entry that it chooses, at most. A
branch has one, `jnp.select` and `jnp.piecewise` have one for each condition."""


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
        self._limits: dict[int, Limits] = {}

    def __getstate__(self) -> dict[str, list]:
        """Without the registers of nodes and of limits, which only serve to add some."""
        return {name: value for name, value in vars(self).items() if name not in ("_known", "_limits")}

    def __setstate__(self, state: dict[str, list]) -> None:
        nodes = zip(state["operations"], state["arguments"], state["parameters"], state["dtypes"], strict=True)
        vars(self).update(state, _known={(o, a, p, d): index for index, (o, a, p, d) in enumerate(nodes)}, _limits={})

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
                    # One that has no number is read by nothing that is needed: what it would give has folded away.
                    made.parameters[node] = arguments.get(argument, argument), entry
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

    def both(self, a: int, b: int) -> int:
        """Whether both truths hold, or the bits that two whole numbers share."""
        return _fold_and(self, a, b)

    def either(self, a: int, b: int) -> int:
        """Whether one of two truths holds, or all bits of two whole numbers."""
        return _fold_or(self, a, b)

    def limits(self, node: int) -> Limits:
        """The least and the largest number that a whole number may be, as far as its operations show."""
        return limits_of(self, node, self._limits)

    def bounded(self, node: int, low: int, high: int) -> int:
        """A whole number that is taken to the nearer bound where it is beyond."""
        least, largest = self.limits(node)
        if largest > high:
            node = self.apply("min", (node, self.constant(high, INT)))
        return self.apply("max", (node, self.constant(low, INT))) if least < low else node

    def wrapped(self, node: int, dtype: np.dtype) -> int:
        """A whole number, computed with 64 bits, as one of a type of fewer bits, which wraps around."""
        if self.is_constant(node):
            return self.constant(self.value(node).astype(dtype), INT)
        least, largest = int(np.iinfo(dtype).min), int(np.iinfo(dtype).max)
        low, high = self.limits(node)
        if least <= low and high <= largest:
            return node
        # The last bits, counted from the least number on.
        begin, bits = self.constant(least, INT), self.constant(largest - least, INT)
        return self.add(self.both(self.sub(node, begin), bits), begin)

    def lookup(self, index: int, cases: Sequence[int]) -> int:
        """One of several nodes, by a whole number; the first one below the range, and the last one beyond, as in JAX.

        Raises:
            NotScalarizable: for more than `LARGEST_TABLE` cases.
        """
        if len(cases) > LARGEST_TABLE:
            raise NotScalarizable(f"a table of {len(cases)} entries that is read at a computed place")
        # Selections by truths are read by all that knows them; a table is for what would be many.
        if (choices := self._choices(index)) is not None:
            return self._chosen(choices, index, cases)
        index = self.bounded(index, 0, len(cases) - 1)
        low, high = self.limits(index)
        index, cases = self.sub(index, self.constant(low, INT)), cases[low : high + 1]
        if all(case == cases[0] for case in cases):
            return cases[0]
        if len(cases) == 2:
            return self.select(self.apply("gt", (index, self.constant(0, INT)), BOOL), *cases)
        return self.node("lookup", (index, *cases), self.dtypes[cases[0]])

    def _choices(self, index: int) -> list[int] | None:
        """The selections by truths that choose among known numbers, as they follow each other.

        None where they choose among others, or are more than `MOST_CHOICES`.
        """
        choices, waiting = set(), {index}
        while waiting:
            node = waiting.pop()
            if self.is_constant(node) or node in choices:
                continue
            if self.operations[node] != "select" or len(choices) == MOST_CHOICES:
                return None
            choices.add(node)
            waiting.update(self.arguments[node][1:])
        return sorted(choices)

    def _chosen(self, choices: list[int], index: int, cases: Sequence[int]) -> int:
        chosen: dict[int, int] = {}

        def of(node: int) -> int:
            return cases[min(max(int(self.value(node)), 0), len(cases) - 1)] if self.is_constant(node) else chosen[node]

        for node in choices:  # an argument is earlier than what reads it
            predicate, on_false, on_true = self.arguments[node]
            chosen[node] = self.select(predicate, of(on_false), of(on_true))
        return of(index)

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
        return self.node(name, arguments, dtype, parameters or None)  # none of them are None and (), which differ

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
_fold_and, _fold_or = _rule("and"), _rule("or")
_fold_neg, _fold_select, _fold_power, _expand_power = (
    _rule("neg"), _rule("select"), _rule("pow"), _rule("integer_pow")
)  # fmt: skip


def by_jax(name: str, parameters: Any) -> Callable[..., Any]:
    """An operation as a function of JAX; `parameters` as of a node."""
    function = OPERATIONS[name].jax
    assert function is not None, f"{name} is folded into others"
    return partial(function, **dict(parameters)) if parameters else function
