"""Clear array code turned into a straight-line scalar program.

XLA on the CPU pays for every small array operation and every call of LAPACK; a right-hand side made of 3-vectors
and small blocks spends nearly all its time there. `scalarize` traces such a function once, follows its jaxpr with
arrays of node names (reshaping and slicing cost nothing: they move names), folds structural zeros and ones,
replaces `symmetric_solve` by an unrolled sparse elimination, and returns a function that emits scalar operations
only. The result is an ordinary JAX function: jit, vmap, jvp, grad work on it.
"""

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.interpreters.partial_eval import dce_jaxpr

from spherejax.compiler.emit.c import PRELUDE, c_functions
from spherejax.compiler.emit.eager import EagerEvaluator
from spherejax.compiler.emit.llvm import FunctionText
from spherejax.compiler.graph import Graph, TooManyOperations
from spherejax.compiler.hooks import attached
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.operations import FLOAT
from spherejax.compiler.primitive import ActiveInputs, StraightLine, grouped, is_called
from spherejax.compiler.trace import Interpreter

MOST_OF_IT = 0.8
"""The share of long sums in the operations of a program from which on its runs are made one by one."""


class ScalarProgram:
    """A function as a straight-line scalar program; call it like the function it was made from.

    Attributes:
        operations: how many operations of each name one call performs.
        n_operations: how many in total.
        n_operations_inside: how many remain in a loop over which the leading arguments are constant.
    """

    C_PRELUDE = PRELUDE
    """What a file of C needs ahead of the functions of `c_source`."""

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
        # What depends on the first arguments alone (the numbers of a scene) is evaluated once, ahead of a loop.
        self._ahead = graph.invariants(self._flat_outputs, range(n_ahead))
        self.n_operations_inside: int = graph.count(self._flat_outputs, self._ahead).total()
        self._lines: dict[tuple, StraightLine] = {}

    def _line(self, part: str, in_vectors: bool = False) -> StraightLine:
        """All of it, what goes ahead, or the rest; for XLA, or as machine code.

        Args:
            part: which one.
            in_vectors: whether what goes ahead is passed on in vectors.
        """
        # JAX traces again in the context of machine code; what it traced outside must stay as it is.
        key = part, in_vectors, machine_code.native_code_enabled()
        if key not in self._lines:
            ahead = grouped(self._ahead, self._graph, in_vectors)
            outputs, shapes, residuals = {
                "whole": (self._outputs, self._shapes, []),
                "first": (ahead, self._shapes[: self._n_leading], []),
                "rest": (self._outputs, self._shapes, ahead),
            }[part]
            self._lines[key] = StraightLine(self._graph, outputs, shapes, residuals, machine_code.native_code_enabled())
        return self._lines[key]

    def __getstate__(self) -> dict[str, Any]:
        """Without what is made of it at its first use; a tree of results stands for its structure."""
        # On disk a program is its graph. Lines hold machine code and derivatives, which are made again when they are
        # asked for.
        state = {name: value for name, value in vars(self).items() if name not in ("_lines", "_eager")}
        return {**state, "_tree": jax.tree.unflatten(self._tree, range(self._tree.num_leaves))}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, _tree=jax.tree.structure(state["_tree"]), _lines={})

    def __call__(self, *arguments) -> Any:
        """Evaluate; the arguments have the shapes of the example arguments."""
        return self._tree_of(self._line("whole")(*self._flat(arguments)))

    @property
    def n_outputs(self) -> int:
        """How many numbers it returns."""
        return len(self._flat_outputs)

    def reads(self, argument: int) -> bool:
        """Whether the outputs depend on an argument (counted in leaves)."""
        graph = self._graph
        needed = graph.needed(self._flat_outputs)
        # By what is needed, not by all inputs of the graph: an argument may have folded away.
        return any(graph.operations[i] == "input" and graph.parameters[i][0] == argument for i in needed)

    def entries_read(self, argument: int) -> np.ndarray:
        """Indices of the entries of an argument (counted in leaves) that the outputs depend on, ascending."""
        graph = self._graph
        inputs = [graph.parameters[i] for i in graph.needed(self._flat_outputs) if graph.operations[i] == "input"]
        return np.array(sorted({entry for leaf, entry in inputs if leaf == argument}), int)

    def dependence(self, argument: int) -> np.ndarray:
        """Which outputs (rows, flat) depend on which entries (columns, flat) of an argument (counted in leaves)."""
        graph = self._graph
        size = int(np.prod(self._shapes[argument]))
        # An integer as a set: joining two is one operation, whatever their size.
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
        # As compiled code, which gives NaN and infinity without a word.
        with np.errstate(all="ignore"):
            values = iter(self._eager(entries))
        outputs = [np.array([next(values) for _ in range(o.size)]).reshape(o.shape) for o in self._outputs]
        return jax.tree.unflatten(self._tree, outputs)

    @cached_property
    def _eager(self) -> EagerEvaluator:
        return EagerEvaluator(self._graph, self._flat_outputs)

    def ahead(self, *leading) -> tuple[Array, ...]:
        """What depends on the leading arguments alone, to be evaluated once ahead of a loop; see `inside`."""
        leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(leading)]
        return tuple(self._line("first", machine_code.native_code_enabled())(*leaves)) if self._ahead else ()

    def inside(self, ahead: tuple[Array, ...], *arguments) -> Any:
        """As a call, with what `ahead` has evaluated for the same leading arguments."""
        line, ahead = self.line_inside(ahead)
        return self._tree_of(line(*self._flat(arguments), *ahead))

    def line_inside(self, ahead: tuple[Array, ...]) -> tuple[StraightLine, tuple[Array, ...]]:
        """What `inside` evaluates, from its arguments one after the other and what was evaluated ahead of them."""
        in_vectors = _are_vectors(ahead)
        if ahead and not in_vectors and machine_code.native_code_enabled():
            # Evaluated outside of the context, as single numbers; a call takes vectors, for each argument costs time.
            kinds = dict.fromkeys(x.dtype for x in ahead)
            ahead = tuple(jnp.stack([x for x in ahead if x.dtype == kind]) for kind in kinds)
            in_vectors = True
        return self._line("rest", in_vectors), ahead

    @cached_property
    def is_of_long_sums(self) -> bool:
        """Whether it is for the most part long sums of products, as a network of hundreds of weights.

        Machine code evaluates the sums of one run in loops over vectors. Eight runs by 4,417 weights take a quarter of
        the time one by one that they take with a number of each in every vector, and by 1,185 weights as long. By 105
        weights, whose sums are too short for such loops, they take twice the time.
        """
        if 2 * self.operations["mul"] < MOST_OF_IT * self.n_operations:
            return False
        return self.n_in_sums >= MOST_OF_IT * self.n_operations

    @cached_property
    def n_in_sums(self) -> int:
        """How many of the operations machine code has in loops over long sums of products."""
        line = self.line_called()
        loops = FunctionText(line, (), (0,) * (len(line.shapes) + len(line.residuals))).loops
        return 0 if loops is None else 2 * loops.n_products

    def line_called(self) -> StraightLine:
        """All of it."""
        return self._line("whole")

    def lines_ahead_and_inside(self) -> tuple[StraightLine | None, StraightLine]:
        """What goes ahead, in vectors, None for nothing; and the rest, which takes these."""
        return self._line("first", True) if self._ahead else None, self._line("rest", True)

    def moving_inside(self, ahead: tuple[Array, ...], moving: Collection[int]) -> tuple[ActiveInputs, ...]:
        """What moves of the first argument, and of what was evaluated ahead, as the line of `line_inside` takes it.

        Args:
            ahead: what was evaluated.
            moving: the entries of the first argument that move.
        """
        line, _ = self.line_inside(ahead)
        graph, moves = self._graph, {}
        for node in graph.needed(line.flat_residuals):
            # Followed through what goes ahead, once, in Python: a derivative then carries no tangents that are zero.
            if graph.operations[node] == "input":
                leaf, entry = graph.parameters[node]
                moves[node] = leaf == 0 and entry in moving
            else:
                moves[node] = any(moves[a] for a in graph.arguments[node])
        places = [tuple(i for i, node in enumerate(group.ravel()) if moves[int(node)]) for group in line.residuals]
        of_residuals = [line.dtype(group) == FLOAT and some for group, some in zip(line.residuals, places, strict=True)]
        return tuple(sorted(moving)), *of_residuals

    def slopes_inside(self, ahead: tuple[Array, ...], slopes: tuple[Array | None, ...]) -> tuple[Array | None, ...]:
        """Derivatives of what was evaluated ahead, as the line of `line_inside` takes it.

        Args:
            ahead: what was evaluated.
            slopes: its derivatives, with a leading axis; None of what is no float.
        """
        if _are_vectors(ahead) or not machine_code.native_code_enabled():
            return slopes
        kinds = dict.fromkeys(x.dtype for x in ahead)
        moving = [slope for slope in slopes if slope is not None]
        return tuple(jnp.stack(moving, -1) if kind == FLOAT else None for kind in kinds)

    @property
    def can_be_machine_code(self) -> bool:
        """Whether `inside` becomes machine code where that is wanted."""
        with machine_code.native_code():
            return is_called(self._line("rest", True), ())

    def _tree_of(self, outputs) -> Any:
        return jax.tree.unflatten(self._tree, outputs)

    def c_source(self, name: str) -> str:
        """The program as functions of C; see `emit.c.c_functions`.

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


def _are_vectors(ahead: tuple[Array, ...]) -> bool:
    return any(jnp.ndim(x) > 0 for x in ahead)


def scalarize(
    function: Callable,
    *examples,
    fixed: Mapping[tuple[int, int], float] | None = None,
    n_ahead: int = 1,
    maximum_operations: int | None = None,
    maximum_in_sums: int = 0,
    has_slopes: bool = True,
) -> ScalarProgram:
    """Turn a function of small arrays into a straight-line scalar program.

    Args:
        function: pure JAX code on float64 arrays.
        *examples: arguments (arrays or `jax.ShapeDtypeStruct`s, in any pytrees); only shapes matter.

    Other args:
        fixed: entries known in advance, `{(leaf number, flat index): value}`: the program folds the values and
            does not read those entries.
        n_ahead: number of leading leaves of the arguments that `ahead` takes.
        maximum_operations: give up beyond this size; None for no limit. Compiling 20,000 operations takes about ten
            seconds, 70,000 more than two minutes.
        maximum_in_sums: operations that may be in long sums of products besides, which machine code has in loops. XLA
            has no loops for them: leave it 0 where the program is for XLA.
        has_slopes: whether what derivative rules give is made with it. Without, it takes a third less to make, and its
            derivatives are those of what it is made of.

    Returns:
        A `ScalarProgram` with the function's signature.

    Raises:
        NotScalarizable: for an operation without a scalar rule (the message names it), or beyond the size.
    """
    # The host's context around foreign code, which may end the process or warn while it is traced.
    with attached().tracing():
        closed, output_shapes = jax.make_jaxpr(function, return_shape=True)(*examples)
    graph = Graph()
    # Known entries are constants from the start, so that all that follows from them folds while the function is traced.
    fixed = fixed or {}
    shapes = [tuple(variable.aval.shape) for variable in closed.jaxpr.invars]
    inputs = []
    for number, shape in enumerate(shapes):
        names = [
            graph.constant(fixed[number, i], FLOAT) if (number, i) in fixed else graph.input((number, i))
            for i in range(int(np.prod(shape)))
        ]
        inputs.append(np.array(names, np.int64).reshape(shape))
    interpreter = Interpreter(graph, maximum_operations, maximum_in_sums, has_slopes=has_slopes)
    # What no output depends on is left out before it is followed; it may have no scalar rule, as a check that is off.
    jaxpr, _ = dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    outputs = interpreter.run(jaxpr, closed.consts, inputs)
    tree = jax.tree.structure(output_shapes)
    program = ScalarProgram(graph, outputs, tree, shapes, getattr(function, "__name__", repr(function)), n_ahead)
    # The interpreter only bounds what is made on the way (`WASTE`); this is the size itself.
    if maximum_operations is not None and program.n_operations > maximum_operations:
        # What is made as a product of arrays need not be one in the end: its numbers may be spread over the arguments.
        n_in_sums = min(program.n_in_sums, maximum_in_sums) if maximum_in_sums else 0
        if program.n_operations - n_in_sums > maximum_operations:
            raise TooManyOperations(f"more than {maximum_operations} scalar operations")
    return program
