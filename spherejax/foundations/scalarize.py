"""Clear array code turned into a straight-line scalar program.

XLA on the CPU pays for every small array operation and every call of LAPACK; a right-hand side made of 3-vectors
and small blocks spends nearly all its time there. `scalarize` traces such a function once, follows its jaxpr with
arrays of node names (reshaping and slicing cost nothing: they move names), folds structural zeros and ones,
replaces `symmetric_solve` by an unrolled sparse elimination, and returns a function that emits scalar operations
only. The result is an ordinary JAX function: jit, vmap, jvp, grad work on it.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.extend import core as jex

from spherejax.foundations.checks import exits_as_errors
from spherejax.foundations.scalar_c import c_functions
from spherejax.foundations.scalar_graph import BOOL, FLOAT, INT, Graph, TooManyOperations
from spherejax.foundations.scalar_rules import ELEMENTWISE, RULES, STRUCTURAL, NotScalarizable, move_names
from spherejax.foundations.straight_line import StraightLine, one_by_one


class ScalarProgram:
    """A function as a straight-line scalar program; call it like the function it was made from.

    Attributes:
        operations: how many operations of each name one call performs.
        n_operations: how many in total.
        n_operations_inside: how many remain in a loop over which the leading arguments are constant.
    """

    def __init__(
        self, graph: Graph, outputs: list[np.ndarray], tree, shapes: list[tuple[int, ...]], name: str, n_ahead: int
    ):
        self._graph = graph
        self._outputs = outputs
        self._tree = tree
        self._shapes = shapes
        self._flat_outputs = [int(node) for output in outputs for node in output.ravel()]
        self.name = name
        self.operations: Counter = graph.count(self._flat_outputs)
        self.n_operations: int = self.operations.total()
        self._n_leading = n_ahead
        self._ahead = graph.invariants(self._flat_outputs, range(n_ahead))
        self.n_operations_inside: int = graph.count(self._flat_outputs, self._ahead).total()
        self._compile()

    def _compile(self) -> None:
        numbers = [np.array(node) for node in self._ahead]
        self._whole = StraightLine(self._graph, self._outputs, self._shapes, ())
        self._first = StraightLine(self._graph, numbers, self._shapes[: self._n_leading], ())
        self._rest = StraightLine(self._graph, self._outputs, self._shapes, self._ahead)

    def __getstate__(self) -> dict[str, Any]:
        """Without what JAX compiles; a tree of results stands for its structure."""
        state = {name: value for name, value in vars(self).items() if name not in ("_whole", "_first", "_rest")}
        return {**state, "_tree": jax.tree.unflatten(self._tree, range(self._tree.num_leaves))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _tree=jax.tree.structure(state["_tree"]))
        self._compile()

    def __call__(self, *arguments) -> Any:
        """Evaluate; the arguments have the shapes of the example arguments."""
        return self._tree_of(self._whole(*self._flat(arguments)))

    @property
    def n_outputs(self) -> int:
        """How many numbers it returns."""
        return len(self._flat_outputs)

    def reads(self, argument: int) -> bool:
        """Whether the outputs depend on an argument (counted in leaves)."""
        graph = self._graph
        needed = graph.needed(self._flat_outputs)
        return any(graph.operations[i] == "input" and graph.parameters[i][0] == argument for i in needed)

    def dependence(self, argument: int) -> np.ndarray:
        """Which outputs (rows, flat) depend on which entries (columns, flat) of an argument (counted in leaves)."""
        graph = self._graph
        size = int(np.prod(self._shapes[argument]))
        sources: dict[int, int] = {}  # for each node the set of entries behind it, as the bits of an integer
        for index in graph.needed(self._flat_outputs):
            if graph.operations[index] == "input":
                leaf, entry = graph.parameters[index]
                sources[index] = 1 << entry if leaf == argument else 0
            else:
                sources[index] = 0
                for node in graph.arguments[index]:
                    sources[index] |= sources[node]
        rows = [[bool(sources[node] >> entry & 1) for entry in range(size)] for node in self._flat_outputs]
        return np.array(rows, bool).reshape(len(self._flat_outputs), size)

    def compute(self, *arguments) -> Any:
        """Evaluate concrete arguments with Python numbers, as NumPy: slower than a compiled call, but at once.

        For what is done once: a compilation takes a second, this a few milliseconds.
        """
        flat = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(arguments)]
        entries = [array.ravel().tolist() for array in flat]
        with np.errstate(all="ignore"):
            values = self._graph.compute(self._flat_outputs, lambda position: entries[position[0]][position[1]])
        outputs = [np.array([values[int(n)] for n in o.ravel()]).reshape(o.shape) for o in self._outputs]
        return jax.tree.unflatten(self._tree, outputs)

    def ahead(self, *leading) -> tuple[Array, ...]:
        """What depends on the leading arguments alone, to be evaluated once ahead of a loop; see `inside`."""
        leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(leading)]
        return tuple(self._first(*leaves)) if self._ahead else ()

    def inside(self, ahead: tuple[Array, ...], *arguments) -> Any:
        """As a call, with what `ahead` has evaluated for the same leading arguments."""
        return self._tree_of(self._rest(*self._flat(arguments), *ahead))

    def _tree_of(self, outputs) -> Any:
        return jax.tree.unflatten(self._tree, outputs)

    def c_source(self, name: str) -> str:
        """The program as functions of C; see `scalar_c.c_functions`.

        Raises:
            NotScalarizable: for an operation that C does not have.
        """
        return c_functions(self._graph, self._flat_outputs, self._ahead, len(self._shapes), name)

    def _flat(self, arguments) -> list[Array]:
        flat = [jnp.asarray(leaf) for leaf in jax.tree.leaves(arguments)]
        shapes = [leaf.shape for leaf in flat]
        if shapes != self._shapes:
            raise ValueError(f"the scalar program {self.name} was made for shapes {self._shapes}, got {shapes}")
        return flat


def scalarize(
    function: Callable,
    *examples,
    fixed: Mapping[tuple[int, int], float] | None = None,
    n_ahead: int = 1,
    maximum_operations: int | None = None,
) -> ScalarProgram:
    """Turn a function of small arrays into a straight-line scalar program.

    Args:
        function: pure JAX code on float64 arrays.
        *examples: arguments (arrays or `jax.ShapeDtypeStruct`s, in any pytrees); only shapes matter.

    Other args:
        fixed: entries known in advance, `{(leaf number, flat index): value}`: the program folds the values and
            does not read those entries.
        n_ahead: number of leading leaves of the arguments that `ahead` is given.
        maximum_operations: give up beyond this size; None for no limit. Compiling 20,000 operations takes about ten
            seconds, 70,000 more than two minutes.

    Returns:
        A `ScalarProgram` with the function's signature.

    Raises:
        NotScalarizable: for an operation without a scalar rule (the message names it), or beyond the size.
    """
    with exits_as_errors():
        closed, output_shapes = jax.make_jaxpr(function, return_shape=True)(*examples)
    graph = Graph()
    fixed = fixed or {}
    shapes = [tuple(variable.aval.shape) for variable in closed.jaxpr.invars]
    inputs = []
    for number, shape in enumerate(shapes):
        names = [
            graph.constant(fixed[number, i], FLOAT) if (number, i) in fixed else graph.input((number, i))
            for i in range(int(np.prod(shape)))
        ]
        inputs.append(np.array(names, np.int64).reshape(shape))
    interpreter = _Interpreter(graph, maximum_operations)
    outputs = interpreter.run(closed.jaxpr, closed.consts, inputs)
    tree = jax.tree.structure(output_shapes)
    program = ScalarProgram(graph, outputs, tree, shapes, getattr(function, "__name__", repr(function)), n_ahead)
    if maximum_operations is not None and program.n_operations > maximum_operations:
        raise TooManyOperations(f"more than {maximum_operations} scalar operations")
    return program


WASTE = 2
"""Nodes of a graph for each operation that is needed in the end, at most: what proves unused is made first (measured on
the right-hand sides of chains and loops: 1.2 to 1.5)."""


class _Interpreter:
    """Follows a jaxpr with arrays of node names."""

    def __init__(self, graph: Graph, maximum_operations: int | None):
        self.graph = graph
        self.limit = maximum_operations

    def run(self, jaxpr, constants, arguments: list[np.ndarray]) -> list[np.ndarray]:
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
        if isinstance(value, jax.core.Tracer):
            raise NotScalarizable("the function closes over a traced value; pass it as an argument")
        array = np.asarray(value)
        dtype = _graph_dtype(array.dtype)
        names = [self.graph.constant(entry, dtype) for entry in array.ravel()]
        return np.array(names, np.int64).reshape(array.shape)

    def equation(self, equation, inputs: list[np.ndarray]) -> list[np.ndarray]:
        name, parameters = equation.primitive.name, equation.params
        inner = _INLINED.get(name)
        if inner is not None:
            closed = parameters[inner]
            return self.run(closed.jaxpr, closed.consts, inputs)
        if name == "straight_line":  # a program within a program
            return self.inlined(one_by_one(**parameters), equation, inputs)
        if name == "scan":
            return self.scan(parameters, inputs)
        if name == "cond":
            return self.cond(parameters, inputs)
        shapes = [variable.aval.shape for variable in equation.outvars]
        dtypes = [_graph_dtype(variable.aval.dtype) for variable in equation.outvars]
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
        closed = jax.make_jaxpr(function)(*(atom.aval for atom in equation.invars))
        return self.run(closed.jaxpr, closed.consts, inputs)

    def elementwise(self, primitive, inputs, parameters, shape, dtype) -> np.ndarray:
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


def _graph_dtype(dtype) -> np.dtype:
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
