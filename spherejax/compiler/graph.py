"""A straight-line program on scalars: nodes, with folding of constants and shared subexpressions.

A node is an operation on earlier nodes. Building a node folds what is known: constants, sums with 0, products with
0 and 1, powers with the exponents 1/2, 1, 3/2 and 2; a node that exists already is used again. A structural
zero times x is 0: the program presumes finite numbers there, as the array program would for a matrix that stores
no zeros.
"""

import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax import lax

FLOAT, BOOL, INT = np.dtype("float64"), np.dtype("bool"), np.dtype("int64")


class NotScalarizable(Exception):  # noqa: N818 - it says what it is
    """The function has no scalar program; the message says which operation stands in the way."""


class TooManyOperations(NotScalarizable):
    """The scalar program of the function would be larger than allowed."""


class Graph:
    """Nodes of a scalar program under construction; a node is named by its index.

    Attributes:
        operations: the operation of each node: a name of `EMIT`, a JAX primitive, `"constant"`, `"input"`, or
            `"tangent"`, which nothing but a slope depends on.
        arguments: the earlier nodes that each node reads.
        parameters: a constant's value, an input's position, the slope of a marked node, or a primitive's parameters.
        dtypes: the NumPy dtype of each node.
    """

    def __init__(self):
        self.operations: list[Any] = []
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
        vars(made).update({name: value.copy() for name, value in vars(self).items()})
        if arguments is not None:
            for node, operation in enumerate(made.operations):
                if operation == "input":
                    argument, entry = made.parameters[node]
                    made.parameters[node] = arguments[argument], entry
            made.__setstate__(made.__getstate__())
        return made

    def node(self, operation, arguments: tuple[int, ...], dtype: np.dtype, parameters=None) -> int:
        """The node for an operation, made only if it does not exist yet."""
        if operation in _COMMUTATIVE and arguments[0] > arguments[1]:
            arguments = (arguments[1], arguments[0])
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
        if dtype == FLOAT and value == 0:
            value = dtype.type(0)
        return self.node("constant", (), dtype, (value.tobytes(), value))

    def input(self, position: tuple[int, int]) -> int:
        """The node of one entry of one argument: `position = (argument, flat index)`."""
        return self.node("input", (), FLOAT, position)

    def tangent(self, node: int) -> int:
        """Stands for the tangent of a node in what `marked` is given; a structural zero for what does not move."""
        if self.is_constant(node):
            return self.constant(0, FLOAT)
        return self.node("tangent", (node,), FLOAT)

    def marked(self, node: int, slope: int | None) -> int:
        """A node with a derivative of its own: one that is linear in tangents of others, `slope`; None is refused.

        Its value is the node's. Whoever differentiates the graph takes the slope, and does not look behind the node.
        """
        return node if self.is_constant(node) else self.node("marked", (node,), self.dtypes[node], slope)

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

    # Arithmetic with folding ------------------------------------------------------------------------------------

    def add(self, a: int, b: int) -> int:
        """a + b."""
        if self.is_value(a, 0):
            return b
        if self.is_value(b, 0):
            return a
        if self.operations[b] == "neg":
            return self.sub(a, self.arguments[b][0])
        if self.operations[a] == "neg":
            return self.sub(b, self.arguments[a][0])
        return self._folded("add", (a, b), lambda x, y: x + y)

    def sub(self, a: int, b: int) -> int:
        """a - b."""
        if self.is_value(b, 0):
            return a
        if self.is_value(a, 0):
            return self.neg(b)
        if a == b and not self.is_constant(a) and self.dtypes[a] == FLOAT:
            return self.constant(0, self.dtypes[a])
        if self.operations[b] == "neg":
            return self.add(a, self.arguments[b][0])
        return self._folded("sub", (a, b), lambda x, y: x - y)

    def mul(self, a: int, b: int) -> int:
        """a * b; 0 when either is a structural zero."""
        for x, y in ((a, b), (b, a)):
            if self.is_constant(x):
                value = self.value(x)
                if value == 0:
                    return self.constant(0, self.dtypes[x])
                if value == 1:
                    return y
                if value == -1:
                    return self.neg(y)
        if self.operations[a] == "neg" and self.operations[b] == "neg":
            return self.mul(self.arguments[a][0], self.arguments[b][0])
        if self.operations[a] == "neg":
            return self.neg(self.mul(self.arguments[a][0], b))
        if self.operations[b] == "neg":
            return self.neg(self.mul(a, self.arguments[b][0]))
        return self._folded("mul", (a, b), lambda x, y: x * y)

    def div(self, a: int, b: int) -> int:
        """a / b."""
        if self.is_value(b, 1):
            return a
        if self.is_value(a, 0) and not self.is_constant(b):
            return a
        return self._folded("div", (a, b), lambda x, y: np.divide(x, y))

    def neg(self, a: int) -> int:
        """-a."""
        if self.operations[a] == "neg":
            return self.arguments[a][0]
        if self.operations[a] == "sub":
            x, y = self.arguments[a]
            return self.sub(y, x)
        return self._folded("neg", (a,), lambda x: -x)

    def select(self, predicate: int, on_false: int, on_true: int) -> int:
        """`on_true` where the predicate holds, else `on_false`."""
        if self.is_constant(predicate):
            return on_true if self.value(predicate) else on_false
        if on_false == on_true:
            return on_true
        return self.node("select", (predicate, on_false, on_true), self.dtypes[on_true])

    def integer_power(self, a: int, exponent: int) -> int:
        """a ** exponent for a Python integer, by repeated multiplication."""
        if exponent < 0:
            return self.div(self.constant(1, FLOAT), self.integer_power(a, -exponent))
        result, square = self.constant(1, FLOAT), a
        while exponent:
            if exponent & 1:
                result = self.mul(result, square)
            exponent >>= 1
            square = self.mul(square, square) if exponent else square
        return result

    def power(self, a: int, b: int) -> int:
        """a ** b for a >= 0; exponents that are small multiples of one half become products and a square root."""
        if self.is_constant(b) and not self.is_constant(a):
            twice = 2 * float(self.value(b))
            if twice == int(twice) and abs(twice) <= 8:
                whole = self.integer_power(a, math.floor(twice / 2))
                if twice % 2 == 0:
                    return whole
                # a sqrt(a) has the derivative 0 at 0, but its factors have 0 and infinity.
                root = "root_guarded_at_zero" if twice > 1 else "sqrt"
                return self.mul(whole, self.node(root, (a,), FLOAT))
        return self._folded("pow", (a, b), np.power)

    def apply(self, primitive, arguments: tuple[int, ...], dtype: np.dtype, parameters: tuple) -> int:
        """Any elementwise JAX primitive, evaluated now when all its arguments are constants."""
        if all(self.is_constant(a) for a in arguments):
            values = [np.asarray(self.value(a)) for a in arguments]
            return self.constant(self.evaluated(primitive, values, parameters), dtype)
        return self.node(primitive, arguments, dtype, parameters)

    def evaluated(self, primitive: Any, values: list, parameters: Any) -> np.ndarray:
        """A primitive of known numbers: by NumPy where it has the same, for JAX compiles a program for each."""
        known = AS_NUMPY.get(primitive.name)
        if known is not None:
            with np.errstate(all="ignore"):
                return np.asarray(known(*values))
        with jax.ensure_compile_time_eval():
            return np.asarray(primitive.bind(*values, **dict(parameters)))

    def _folded(self, operation: str, arguments: tuple[int, ...], evaluate: Callable) -> int:
        dtype = self.dtypes[arguments[0]]
        if all(self.is_constant(a) for a in arguments):
            with np.errstate(all="ignore"):
                return self.constant(evaluate(*(self.value(a) for a in arguments)), dtype)
        return self.node(operation, arguments, dtype)

    # Emission ---------------------------------------------------------------------------------------------------

    def needed(self, outputs: Sequence[int], given: Collection[int] = (), with_slopes: bool = False) -> list[int]:
        """The nodes that the outputs depend on, in an order in which they can be evaluated.

        Args:
            outputs: nodes.
            given: nodes that are not looked behind.
            with_slopes: with the slopes of marked nodes, and what they depend on.
        """
        given = frozenset(given)
        is_needed = np.zeros(len(self.operations), bool)
        is_needed[list(outputs)] = True
        for index in range(len(self.operations) - 1, -1, -1):
            if is_needed[index] and index not in given:
                for argument in self.arguments[index]:
                    is_needed[argument] = True
                if with_slopes and self.operations[index] == "marked" and self.parameters[index] is not None:
                    is_needed[self.parameters[index]] = True
        return [int(index) for index in np.flatnonzero(is_needed)]

    def invariants(self, outputs: Sequence[int], given: Collection[int]) -> list[int]:
        """The operations that depend on given arguments alone and are read by others that depend on more (or returned).

        These are what can be evaluated once, ahead of a loop in which those arguments do not change.
        """
        is_invariant: dict[int, bool] = {}
        frontier = set()
        for index in self.needed(outputs):
            operation = self.operations[index]
            if operation == "input":
                is_invariant[index] = self.parameters[index][0] in given
            else:
                is_invariant[index] = all(is_invariant[a] for a in self.arguments[index])
            if not is_invariant[index]:
                frontier.update(a for a in self.arguments[index] if is_invariant[a])
        frontier.update(index for index in outputs if is_invariant[index])
        return sorted(index for index in frontier if self.operations[index] not in ("constant", "input"))

    def count(self, outputs: Sequence[int], given: Collection[int] = ()) -> Counter:
        """How many operations of each name the outputs need (`FREE` and given nodes not counted)."""
        names = Counter()
        for index in self.needed(outputs, given):
            operation = self.operations[index]
            if operation not in FREE and index not in given:
                names[operation if isinstance(operation, str) else operation.name] += 1
        return names

    def emit(
        self,
        outputs: Sequence[int],
        read: Callable[[tuple[int, int]], jax.Array],
        given: Mapping[int, jax.Array] | None = None,
    ) -> dict[int, jax.Array]:
        """Evaluate the outputs with JAX scalars (or tracers); `read(position)` gives the inputs."""
        values: dict = dict(given or {})
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
                if isinstance(operation, str):
                    values[index] = EMIT[operation](*arguments)
                else:
                    values[index] = operation.bind(*arguments, **dict(self.parameters[index]))
        return values


FREE = frozenset({"constant", "input", "marked"})
"""Names of nodes that cost nothing."""

_COMMUTATIVE = frozenset({"add", "mul"})


def _root_guarded_at_zero(a):
    is_zero = lax.eq(a, lax.full_like(a, 0.0))
    root = lax.sqrt(lax.select_n(is_zero, a, lax.full_like(a, 1.0)))
    return lax.select_n(is_zero, root, lax.full_like(a, 0.0))


EMIT: dict[str, Callable] = {
    "root_guarded_at_zero": _root_guarded_at_zero,
    "marked": lambda a: a,
    "add": lax.add,
    "sub": lax.sub,
    "mul": lax.mul,
    "div": lax.div,
    "neg": lax.neg,
    "pow": lax.pow,
    "sqrt": lax.sqrt,
    "select": lambda predicate, on_false, on_true: lax.select_n(predicate, on_false, on_true),
}

AS_NUMPY: dict[str, Callable] = {
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal, "eq": np.equal, "ne": np.not_equal,
    "max": np.maximum, "min": np.minimum, "abs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil,
    "exp": np.exp, "exp2": np.exp2, "log": np.log, "log1p": np.log1p, "expm1": np.expm1, "tanh": np.tanh,
    "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "atan2": np.arctan2, "sinh": np.sinh, "cosh": np.cosh, "cbrt": np.cbrt, "sqrt": np.sqrt, "not": np.invert,
    "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "is_finite": np.isfinite, "neg": np.negative,
}  # fmt: skip
"""Functions of NumPy that are those of JAX by these names, of float64, integers and truth values."""
