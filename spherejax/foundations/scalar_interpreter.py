"""Follows the operations of JAX with arrays of names of scalar nodes."""

import jax
import jax.core
import numpy as np
from jax.extend import core as jex

from spherejax.foundations.scalar_graph import BOOL, FLOAT, INT, Graph, NotScalarizable, TooManyOperations
from spherejax.foundations.scalar_rules import ELEMENTWISE, RULES, STRUCTURAL, move_names

WASTE = 2
"""Nodes of a graph for each operation that is needed in the end, at most: what proves unused is made first (measured on
the right-hand sides of chains and loops: 1.2 to 1.5)."""


class Interpreter:
    """Follows a jaxpr with arrays of node names, adding nodes to a graph."""

    def __init__(self, graph: Graph, maximum_operations: int | None = None):
        self.graph = graph
        self.limit = maximum_operations

    def run(self, jaxpr, constants, arguments: list[np.ndarray]) -> list[np.ndarray]:
        """The names of a jaxpr's outputs."""
        environment: dict = {}

        def read(atom):
            return self.names_of(atom.val) if isinstance(atom, jex.Literal) else environment[atom]

        for variable, constant in zip(jaxpr.constvars, constants, strict=True):
            environment[variable] = self.names_of(constant)
        environment.update(zip(jaxpr.invars, arguments, strict=True))
        for equation in jaxpr.eqns:
            outputs = self.equation(equation, [read(atom) for atom in equation.invars])
            environment.update(zip(equation.outvars, outputs, strict=True))
            if self.limit is not None and len(self.graph.operations) > WASTE * self.limit:
                raise TooManyOperations(f"more than {self.limit} scalar operations")
        return [read(atom) for atom in jaxpr.outvars]

    def names_of(self, value) -> np.ndarray:
        """The names of an array's entries, constants."""
        if isinstance(value, jax.core.Tracer):
            raise NotScalarizable("the function closes over a traced value; pass it as an argument")
        array = np.asarray(value)
        dtype = graph_dtype(array.dtype)
        names = [self.graph.constant(entry, dtype) for entry in array.ravel()]
        return np.array(names, np.int64).reshape(array.shape)

    def equation(self, equation, inputs: list[np.ndarray]) -> list[np.ndarray]:
        """The names of what an operation of JAX gives."""
        name, parameters = equation.primitive.name, equation.params
        inner = _INLINED.get(name)
        if inner is not None:
            closed = parameters[inner]
            return self.run(closed.jaxpr, closed.consts, inputs)
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
        if name in STRUCTURAL:
            return move_names(self.graph, equation.primitive, parameters, inputs, shapes)
        if name in RULES:
            return RULES[name](self.graph, inputs, parameters, shapes, dtypes)
        if name in ELEMENTWISE:
            return [self.elementwise(equation.primitive, inputs, parameters, shapes[0], dtypes[0])]
        raise NotScalarizable(f"the operation {name!r} has no scalar rule")

    def inlined(self, function, equation, inputs: list[np.ndarray]) -> list[np.ndarray]:
        """The names of what a function gives that stands for an operation."""
        closed = jax.make_jaxpr(function)(*(atom.aval for atom in equation.invars))
        return self.run(closed.jaxpr, closed.consts, inputs)

    def elementwise(self, primitive, inputs, parameters, shape, dtype) -> np.ndarray:
        """A node for each entry."""
        frozen = tuple(sorted(parameters.items()))
        flat = [np.broadcast_to(array, shape).ravel() for array in inputs]
        names = [
            self.graph.apply(primitive, tuple(map(int, entry)), dtype, frozen) for entry in zip(*flat, strict=True)
        ]
        return np.array(names, np.int64).reshape(shape)

    def scan(self, parameters, inputs) -> list[np.ndarray]:
        """A loop with a static number of turns, unrolled."""
        n_constants, n_carried = parameters["num_consts"], parameters["num_carry"]
        constants, carried = inputs[:n_constants], inputs[n_constants : n_constants + n_carried]
        columns = inputs[n_constants + n_carried :]
        closed, length = parameters["jaxpr"], parameters["length"]
        turns = range(length - 1, -1, -1) if parameters["reverse"] else range(length)
        stacked: list[list] = []
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
        """Branches: the one that is taken when that is known, else both and a selection, as under vmap."""
        index, operands, branches = int(inputs[0]), inputs[1:], parameters["branches"]
        graph = self.graph
        if graph.is_constant(index):
            chosen = branches[int(np.clip(int(graph.value(index)), 0, len(branches) - 1))]
            return self.run(chosen.jaxpr, chosen.consts, operands)
        index = graph.predicate_of(index)
        if len(branches) != 2 or graph.dtypes[index] != BOOL:
            raise NotScalarizable("a switch between more than two branches")
        on_false, on_true = (self.run(branch.jaxpr, branch.consts, operands) for branch in branches)
        return [
            np.vectorize(lambda f, t: graph.select(index, int(f), int(t)), otypes=[np.int64])(false, true)
            for false, true in zip(on_false, on_true, strict=True)
        ]


_INLINED = {
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "checkpoint": "jaxpr",
}


def graph_dtype(dtype) -> np.dtype:
    """The type of a node for an array's entries."""
    try:
        kind = np.dtype(dtype).kind
    except TypeError:  # a dtype of JAX's own, such as that of random keys
        raise NotScalarizable(f"values of type {dtype}") from None
    if dtype == FLOAT:
        return FLOAT
    if kind == "b":
        return BOOL
    if kind in "iu":
        return INT
    raise NotScalarizable(f"numbers of type {dtype}")
