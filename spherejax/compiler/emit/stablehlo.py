"""Writes the operations of scalar programs in the compiler's language, StableHLO, lanes included."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jax.core import ShapedArray
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import stablehlo
from jax.interpreters import mlir

from spherejax.compiler.emit.llvm_sums import beside
from spherejax.compiler.graph import by_jax
from spherejax.compiler.operations import BOOL, FLOAT, INT, OPERATIONS, WRITTEN_OUT, entry_of

Shape = tuple[int, ...]


def sizes(lanes: Shape, axes: int) -> Shape:
    """Sizes of a set of axes of lanes, an integer with a bit for each."""
    return tuple(n for axis, n in enumerate(lanes) if axes >> axis & 1)


class Writer:
    """Writes the operations of a line as StableHLO.

    A node has the axes of what it depends on, and is spread over more where it meets a node that has them.
    """

    def __init__(self, context: Any, line: Any, lanes: Shape, axes: tuple[int, ...], arguments: Sequence):
        self.context, self.line, self.graph, self.lanes = context, line, line.graph, lanes
        self.axes, (self.spread, self.outputs_spread) = axes, line.spread(axes)
        self.elements = {
            FLOAT: ir.F64Type.get(), BOOL: ir.IntegerType.get_signless(1), INT: ir.IntegerType.get_signless(64),
        }  # fmt: skip
        # Kept, since each call into MLIR takes microseconds, and a program has thousands of nodes of a few types.
        self.types: dict[tuple[np.dtype, int], Any] = {}
        # Flat once: an entry is then one slice, whatever the shape of its argument.
        self.flat = [self._flat(i, x) for i, x in enumerate(arguments[: len(line.shapes)])]
        self.values: dict[int, Any] = {}
        n = len(line.shapes)
        for i, (group, x) in enumerate(zip(line.residuals, arguments[n:], strict=True), n):
            if group.shape == ():
                self.values[int(group)] = x
                continue
            for at, node in enumerate(group):
                self.values[int(node)] = self._row(x, at, line.graph.dtypes[int(node)], axes[i])
        self.wide: dict[tuple[int, int], Any] = {}

    def written(self) -> list:
        """The outputs."""
        for node in self.line.nodes:
            if node not in self.values:
                self.values[node] = self._node(node)
        return [self._output(*output) for output in zip(self.line.outputs, self.outputs_spread, strict=True)]

    def _node(self, node: int) -> Any:
        graph, operation = self.graph, self.graph.operations[node]
        # Without lanes: where it meets a node that has them it is spread, and XLA folds that.
        if operation == "constant":
            return mlir.ir_constant(np.asarray(graph.value(node), graph.dtypes[node]))
        if operation == "input":
            return self._entry(*graph.parameters[node])
        if operation == "lookup" and len(graph.arguments[node]) > WRITTEN_OUT + 1:
            return self._looked_up(node)
        arguments = [self._over(self.spread[node], a) for a in graph.arguments[node]]
        write = OPERATIONS[operation].stablehlo
        return self._by_jax(node, operation, arguments) if write is None else write(*arguments)

    def _by_jax(self, node: int, operation: str, arguments: list) -> Any:
        """An operation as JAX writes it."""
        graph, shape = self.graph, sizes(self.lanes, self.spread[node])
        # For operations that StableHLO has no word for, as erf: JAX's own rule writes several of them.
        function = by_jax(operation, graph.parameters[node])
        avals = [ShapedArray(shape, graph.dtypes[a]) for a in graph.arguments[node]]
        return self._lowered(function, avals, ShapedArray(shape, graph.dtypes[node]), arguments)

    def _lowered(self, function: Callable, avals: list, result_aval: ShapedArray, arguments: list) -> Any:
        context = self.context.replace(avals_in=avals, avals_out=[result_aval])
        (result,) = mlir.lower_fun(function, multiple_results=False)(context, *arguments)
        return result

    def _looked_up(self, node: int) -> Any:
        """An entry of a table: of one array, where its entries are constants, or side by side in an argument."""
        graph, (index, *cases), axes = self.graph, self.graph.arguments[node], self.spread[node]
        dtype, lanes = graph.dtypes[node], sizes(self.lanes, axes)
        own = [None if case in self.line.flat_residuals else graph.operations[case] for case in cases]
        places = [graph.parameters[case] if what == "input" else None for case, what in zip(cases, own, strict=True)]
        if all(what == "constant" for what in own):
            table, over = mlir.ir_constant(np.array([graph.value(case) for case in cases], dtype)), 0
        elif (place := beside(places)) is not None:
            over = self.axes[place[0]]
            table = self._rows(self.flat[place[0]], place[1], len(cases), over)
        else:
            one, over = ir.RankedTensorType.get((1, *lanes), self.elements[dtype]), axes
            rows = [stablehlo.reshape(one, self._over(axes, case)) for case in cases]
            table = stablehlo.concatenate(rows, mlir.i64_attr(0))
        if over and over != axes:
            among = [axis for axis in range(len(self.lanes)) if axes >> axis & 1]
            dims = ir.DenseI64ArrayAttr.get([0, *(1 + at for at, axis in enumerate(among) if over >> axis & 1)])
            wide = ir.RankedTensorType.get((len(cases), *lanes), self.elements[dtype])
            table, over = stablehlo.broadcast_in_dim(wide, table, dims), axes
        avals = [ShapedArray(lanes, INT), ShapedArray((len(cases), *sizes(self.lanes, over)), dtype)]
        return self._lowered(entry_of, avals, ShapedArray(lanes, dtype), [self._over(axes, index), table])

    def _type(self, dtype: np.dtype, axes: int) -> Any:
        if (dtype, axes) not in self.types:
            self.types[dtype, axes] = ir.RankedTensorType.get(sizes(self.lanes, axes), self.elements[dtype])
        return self.types[dtype, axes]

    def _over(self, axes: int, node: int) -> Any:
        """The value of a node over a set of axes."""
        own = self.spread[node]
        if own == axes:
            return self.values[node]
        # Kept: the same number is spread once for all that meet it, and not for each.
        if (node, axes) not in self.wide:
            among = [axis for axis in range(len(self.lanes)) if axes >> axis & 1]
            dims = ir.DenseI64ArrayAttr.get([at for at, axis in enumerate(among) if own >> axis & 1])
            kind = self._type(self.graph.dtypes[node], axes)
            self.wide[node, axes] = stablehlo.broadcast_in_dim(kind, self.values[node], dims)
        return self.wide[node, axes]

    def _flat(self, argument: int, x: Any) -> Any:
        shape = int(np.prod(self.line.shapes[argument])), *sizes(self.lanes, self.axes[argument])
        return stablehlo.reshape(ir.RankedTensorType.get(shape, self.elements[FLOAT]), x)

    def _entry(self, argument: int, index: int) -> Any:
        return self._row(self.flat[argument], index, FLOAT, self.axes[argument])

    def _row(self, array: Any, index: int, dtype: np.dtype, axes: int) -> Any:
        """One entry of a flat argument, with its lanes."""
        return stablehlo.reshape(self._type(dtype, axes), self._rows(array, index, 1, axes))

    def _rows(self, array: Any, index: int, n: int, axes: int) -> Any:
        """Some entries of a flat argument that follow each other, with their lanes."""
        lanes = sizes(self.lanes, axes)
        begin, end = [index, *(0 for _ in lanes)], [index + n, *lanes]
        attributes = [ir.DenseI64ArrayAttr.get(numbers) for numbers in (begin, end, [1] * len(begin))]
        return stablehlo.slice(array, *attributes)

    def _output(self, output: np.ndarray, axes: int) -> Any:
        lanes, element = sizes(self.lanes, axes), self.elements[self.line.dtype(output)]
        if output.size == 0:  # StableHLO concatenates at least one
            return mlir.ir_constant(np.zeros(output.shape))
        one = ir.RankedTensorType.get((1, *lanes), element)
        nodes = [int(node) for node in output.ravel()]
        # A node that is returned several times is shaped once.
        rows = {node: stablehlo.reshape(one, self._over(axes, node)) for node in dict.fromkeys(nodes)}
        parts = [rows[node] for node in nodes]
        whole = parts[0] if len(parts) == 1 else stablehlo.concatenate(parts, mlir.i64_attr(0))
        return stablehlo.reshape(ir.RankedTensorType.get((*output.shape, *lanes), element), whole)
