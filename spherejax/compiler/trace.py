"""Follows the operations of JAX with arrays of names of scalar nodes."""

import itertools
from contextlib import contextmanager

import jax
import jax.core
import numpy as np
from jax.extend import core as jex

from spherejax.compiler import private
from spherejax.compiler.array_operations import ARRAY_OPERATIONS, Use, both_arranged, by_entry
from spherejax.compiler.emit.llvm_sums import SHORTEST
from spherejax.compiler.graph import Graph, TooManyOperations
from spherejax.compiler.operations import (
    BOOL,
    FLOAT,
    MAY_OVERFLOW,
    OF_PRIMITIVE,
    NotScalarizable,
    graph_dtype,
    inner_program,
)

WASTE = 2
"""Nodes of a graph for each operation that is needed in the end, at most: what proves unused is made first (measured on
the right-hand sides of chains and loops: 1.2 to 1.5)."""


class Interpreter:
    """Follows a jaxpr with arrays of node names, adding nodes to a graph.

    Args:
        graph: what nodes are added to.
        maximum_operations: of what is made, at most; None for no limit.
        maximum_in_sums: operations in long sums of products that are allowed besides.
        has_slopes: whether derivative rules are followed.
    """

    def __init__(
        self,
        graph: Graph,
        maximum_operations: int | None = None,
        maximum_in_sums: int = 0,
        *,
        has_slopes: bool = True,
    ):
        self.graph = graph
        self.has_slopes = has_slopes
        self.limit, self.limit_of_sums = maximum_operations, maximum_in_sums
        self._depth = 0
        self._n_given, self._n_for_slopes, self._n_in_sums = len(graph.operations), 0, 0

    def run(self, jaxpr, constants, arguments: list[np.ndarray]) -> list[np.ndarray]:
        """The names of a jaxpr's outputs."""
        # A variable is an array of node names, so that operations that only move entries cost nothing.
        environment: dict = {}

        def read(atom):
            return self.names_of(atom.val) if isinstance(atom, jex.Literal) else environment[atom]

        for variable, constant in zip(jaxpr.constvars, constants, strict=True):
            environment[variable] = self.names_of(constant)
        environment.update(zip(jaxpr.invars, arguments, strict=True))
        for equation in jaxpr.eqns:
            inputs = [read(atom) for atom in equation.invars]
            if self._follows_rule(equation):
                outputs = self.custom_jvp_nodes(jaxpr, equation, inputs)
            else:
                outputs = self.equation(equation, inputs)
            environment.update(zip(equation.outvars, outputs, strict=True))
            # Counted while it grows: a program far above the limit takes minutes to make. What derivative rules give
            # does not count: it is there for those who ask for it.
            if self.limit is not None and self._n_made - self._n_for_slopes > WASTE * self.limit:
                raise TooManyOperations(f"more than {self.limit} scalar operations")
        return [read(atom) for atom in jaxpr.outvars]

    @property
    def _n_made(self) -> int:
        """Nodes so far, without what is given and without long sums of products."""
        return len(self.graph.operations) - self._n_given - self._n_in_sums

    def names_of(self, value) -> np.ndarray:
        """The names of an array's entries, constants."""
        if isinstance(value, jax.core.Tracer):
            raise NotScalarizable("the function closes over a traced value; pass it as an argument")
        if hasattr(value, "dtype") and jax.numpy.issubdtype(value.dtype, jax.dtypes.extended):
            raise NotScalarizable("keys of random numbers have no scalar rule")
        array = np.asarray(value)
        if array.dtype == jax.dtypes.float0:  # the tangent of an index has no values; nothing reads it
            array = np.zeros(array.shape, BOOL)
        dtype = graph_dtype(array.dtype)
        names = [self.graph.constant(entry, dtype) for entry in array.ravel()]
        return np.array(names, np.int64).reshape(array.shape)

    def equation(self, equation, inputs: list[np.ndarray]) -> list[np.ndarray]:
        """The names of what an operation of JAX gives."""
        name, parameters = equation.primitive.name, equation.params
        inner = inner_program(name, parameters)
        if inner is not None:  # inlined: a straight line has no calls
            return self.run(*inner, inputs)
        if name == "straight_line":  # a program within a program
            line, how = parameters["line"], {name: parameters[name] for name in ("lanes", "axes")}
            return self.inlined(line.one_by_one(**how), equation, inputs)
        if name == "scan":
            return self.scan(parameters, inputs)
        if name == "cond":
            return self.cond(parameters, inputs)
        shapes = [variable.aval.shape for variable in equation.outvars]
        dtypes = [graph_dtype(variable.aval.dtype) for variable in equation.outvars]
        if all(0 in shape for shape in shapes):
            return [np.zeros(shape, np.int64) for shape in shapes]
        types = [variable.aval.dtype for variable in equation.outvars]
        use = Use(equation.primitive, parameters, shapes, dtypes, types)
        if (operation := OF_PRIMITIVE.get(name)) is not None:
            return self._in_range(name, by_entry(self.graph, operation, inputs, use), equation)
        if (on_arrays := ARRAY_OPERATIONS.get(name)) is not None and on_arrays.names is not None:
            if name == "dot_general":
                self._note_sums(parameters, inputs)
            return self._in_range(name, on_arrays.names(self.graph, inputs, use), equation)
        raise NotScalarizable(f"the operation {name!r} has no scalar rule")

    def _in_range(self, name: str, outputs: list[np.ndarray], equation) -> list[np.ndarray]:
        """What an operation gives, with whole numbers in the range of their own type: all are computed with 64 bits."""
        types = [variable.aval.dtype for variable in equation.outvars]
        narrow = [np.dtype(dtype) for dtype in types if dtype != jax.dtypes.float0]
        if name not in MAY_OVERFLOW or not any(dtype.kind in "iu" and dtype.itemsize < 8 for dtype in narrow):
            return outputs
        (dtype,), (array,) = narrow, outputs
        return [_by_entry(lambda node: self.graph.wrapped(node, dtype), array)]

    def _note_sums(self, parameters, inputs: list[np.ndarray]) -> None:
        """Count a product of arrays that loops may evaluate, ahead of making thousands of nodes for it."""
        # Products that derivative rules make are among what does not count already.
        if self.limit is None or not self.limit_of_sums or self._depth:
            return
        a, b = both_arranged(inputs, parameters)
        if a.shape[2] < SHORTEST:
            return
        self._n_in_sums += 2 * a.shape[0] * a.shape[1] * b.shape[1] * a.shape[2]
        if self._n_in_sums > self.limit_of_sums:
            raise TooManyOperations(f"more than {self.limit_of_sums} scalar operations in sums of products")

    def inlined(self, function, equation, inputs: list[np.ndarray]) -> list[np.ndarray]:
        """The names of what a function gives that stands for an operation."""
        # Traced from shapes alone: values are names of nodes here, which JAX cannot evaluate with.
        closed = jax.make_jaxpr(function)(*(atom.aval for atom in equation.invars))
        return self.run(closed.jaxpr, closed.consts, inputs)

    # Derivative rules -------------------------------------------------------------------------------------------------

    def _follows_rule(self, equation) -> bool:
        """Whether its derivative is to be taken by the operation's own rule, not through what it is made of."""
        if not self.has_slopes:
            return False
        on_arrays = ARRAY_OPERATIONS.get(equation.primitive.name)
        if on_arrays is not None and on_arrays.solves:  # whose rule is the same, but shorter
            return self._depth == 0
        return equation.primitive.name == "custom_jvp_call" and self._depth <= HIGHEST_DERIVATIVE

    def custom_jvp_nodes(self, jaxpr, equation, inputs: list[np.ndarray]) -> list[np.ndarray]:
        """The names of what an operation gives, as nodes that have the derivative of its own rule."""
        places = [i for i, variable in enumerate(equation.outvars) if _has_derivative(variable)]
        with self._at(HIGHEST_DERIVATIVE + 1):  # rules of what it is made of do not count
            values = self.equation(equation, inputs)
        self._bound_size(values)
        # Beyond the highest order the rule is not followed: a derivative of that order is refused by name.
        slopes = itertools.repeat(None)
        if self._depth < HIGHEST_DERIVATIVE:
            begin, own = len(self.graph.operations), self._n_for_slopes
            with self._at(self._depth + 1):
                slopes = self._slopes(jaxpr, equation, inputs, [equation.outvars[i] for i in places])
            # What was counted within is part of it: rules of rules.
            self._n_for_slopes = own + len(self.graph.operations) - begin
        for i, names in zip(places, slopes, strict=False):  # `repeat` has no end
            names = np.full(values[i].shape, None) if names is None else names
            values[i] = _by_entry(self.graph.custom_jvp_node, values[i], names)
        return values

    def _bound_size(self, values: list[np.ndarray]) -> None:
        """Give up a program of which a part alone is too large, before derivative rules are followed through it."""
        if self.limit is None or self._depth or self._n_made <= self.limit:
            return
        n_made = self.graph.count([int(node) for names in values for node in names.ravel()]).total()
        if n_made - self._n_in_sums > self.limit:
            raise TooManyOperations(f"more than {self.limit} scalar operations")

    def _slopes(self, jaxpr, equation, inputs: list[np.ndarray], wanted: list) -> list[np.ndarray]:
        """What the derivative rule of an operation gives, linear in the tangents of its arguments."""
        # By variable: an argument that is passed twice is one variable, with one tangent.
        arguments = {a: x for a, x in zip(equation.invars, inputs, strict=True) if not isinstance(a, jex.Literal)}
        moving = {atom: _by_entry(self.graph.tangent, x) for atom, x in arguments.items() if atom.aval.dtype == FLOAT}
        # The equation as a program of its own, so that JAX applies the rule that it has for it.
        alone = jaxpr.replace(constvars=[], invars=[*arguments], outvars=wanted, eqns=[equation])
        evaluated = jex.jaxpr_as_fun(jex.ClosedJaxpr(alone, []))

        def along(values, tangents):
            primals = dict(zip(arguments, values, strict=True))

            def of_moving(*numbers):
                moved = primals | dict(zip(moving, numbers, strict=True))
                return evaluated(*(moved[atom] for atom in arguments))

            return jax.jvp(of_moving, [primals[atom] for atom in moving], tangents)[1]

        closed = jax.make_jaxpr(along)([atom.aval for atom in arguments], [atom.aval for atom in moving])
        return self.run(closed.jaxpr, closed.consts, [*arguments.values(), *moving.values()])

    @contextmanager
    def _at(self, depth: int):
        before, self._depth = self._depth, depth
        try:
            yield
        finally:
            self._depth = before

    # Operations -------------------------------------------------------------------------------------------------------

    def scan(self, parameters, inputs) -> list[np.ndarray]:
        """A loop with a static number of turns, unrolled."""
        n_constants, n_carried = private.counts_of_scan(parameters)
        constants, carried = inputs[:n_constants], inputs[n_constants : n_constants + n_carried]
        columns = inputs[n_constants + n_carried :]
        closed, length = parameters["jaxpr"], parameters["length"]
        turns = range(length - 1, -1, -1) if parameters["reverse"] else range(length)
        stacked: list[list] = []
        # A jaxpr is followed again in each turn: names differ, and folding goes further where a turn has constants.
        for turn in turns:
            outputs = self.run(
                closed.jaxpr, closed.consts, [*constants, *carried, *(column[turn] for column in columns)]
            )
            carried = outputs[:n_carried]
            stacked.append(outputs[n_carried:])
        if parameters["reverse"]:
            stacked.reverse()
        return [*carried, *(np.stack(column) for column in zip(*stacked, strict=True))]

    def cond(self, parameters, inputs) -> list[np.ndarray]:
        """Branches: the one that is taken when that is known, else all and a selection, as under vmap."""
        index, operands, branches = int(inputs[0]), inputs[1:], parameters["branches"]
        graph = self.graph
        if graph.is_constant(index):
            chosen = branches[int(np.clip(int(graph.value(index)), 0, len(branches) - 1))]
            return self.run(chosen.jaxpr, chosen.consts, operands)
        of_branches = [self.run(branch.jaxpr, branch.consts, operands) for branch in branches]
        return [
            _by_entry(lambda *cases: graph.lookup(index, cases), *outputs) for outputs in zip(*of_branches, strict=True)
        ]


def _has_derivative(variable) -> bool:
    """Whether something that is read may move."""
    return not private.is_dropped(variable) and variable.aval.dtype == FLOAT


def _by_entry(function, *arrays: np.ndarray) -> np.ndarray:
    """A function of nodes, for each entry."""
    names = [function(*nodes) for nodes in zip(*(array.ravel().tolist() for array in arrays), strict=True)]
    return np.array(names, np.int64).reshape(arrays[0].shape)


HIGHEST_DERIVATIVE = 3
"""Order up to which derivative rules of a user's functions (`jax.custom_jvp`) are followed; higher ones are refused."""
