"""A scalar program as one operation of JAX, written straight into the compiler's language.

To JAX two thousand scalar operations are two thousand objects to trace, to batch and to lower, at a tenth of a
millisecond each for every time that the program is used. As one operation (`straight_line`) they are none of this until
the program is compiled: the lowering rule writes them as StableHLO, lanes and all. Derivatives, forward and back, are
straight lines again; see `derivatives`.

Mapped by `jax.vmap`, the operation gets axes of lanes. They stand last in the arguments that have them, in the order of
the mappings; a set of axes is an integer with a bit for each.
"""

import itertools
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import cached_property, partial, reduce
from operator import or_
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from spherejax.compiler import private, several_results
from spherejax.compiler.autodiff import Forward, Transposed
from spherejax.compiler.emit.llvm import can_be_written
from spherejax.compiler.emit.stablehlo import Shape, Writer, sizes
from spherejax.compiler.graph import Graph
from spherejax.compiler.lanes import by_a_loop, in_first_lanes, inside_a_loop, narrowed, widened
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.operations import FLOAT


class StraightLine:
    """Part of a graph, from arrays to arrays (static: it is compared by its identity).

    Attributes:
        graph: the nodes.
        outputs: names of the nodes that are returned, in arrays.
        shapes: of the arguments whose entries are the graph's inputs.
        residuals: nodes whose values are arguments too, behind the arrays: numbers, or vectors of them. They come from
            another line: what was evaluated ahead of a loop, or the coefficients of a derivative.
        in_machine_code: whether it is called as machine code of its own, where that can be; see `native.compile`. Then
            what it gives to its derivatives are vectors: each argument of a call costs time.
    """

    def __init__(
        self,
        graph: Graph,
        outputs: Sequence[np.ndarray],
        shapes: Sequence[Shape],
        residuals: Sequence[np.ndarray],
        in_machine_code: bool = False,
    ):
        self.graph, self.outputs, self.shapes, self.residuals = graph, tuple(outputs), tuple(shapes), tuple(residuals)
        self.flat_residuals = tuple(int(node) for group in self.residuals for node in group.ravel())
        self.in_machine_code = in_machine_code
        self.called: dict[tuple, str] = {}  # names of its machine code, which go when it goes
        # Made at the first use and kept with the line: JAX asks for shapes, lanes and derivatives again and again.
        self._spread: dict = {}
        self._jitted: dict = {}
        self._derivatives: dict[tuple[tuple[ActiveInputs, ...], bool], Derivative] = {}
        self._transposes: dict[tuple[tuple[bool, ...], tuple[bool, ...]], StraightLine] = {}

    def __call__(self, *arguments: Array) -> list[Array]:
        """Evaluate; arrays first, then residuals."""
        return _straight_line.bind(*arguments, line=self, lanes=(), axes=(0,) * len(arguments))

    def __repr__(self) -> str:
        """What it does, so that a printed program still says which operations it has."""
        counts = self.graph.count(self._flat, self.flat_residuals)
        return f"StraightLine({', '.join(f'{name} {n}' for name, n in sorted(counts.items()))})"

    def __cache_key__(self) -> tuple:
        """What it computes, for fingerprints of programs."""
        # Places instead of names of nodes: names depend on what else the graph has been used for.
        graph, nodes = self.graph, self._with_slopes
        place = {node: at for at, node in enumerate(nodes)}
        residuals = {node: at for at, node in enumerate(self.flat_residuals)}
        lines = tuple(
            (residuals[node],)
            if node in residuals
            else (
                str(graph.operations[node]),
                tuple(place[a] for a in graph.arguments[node]),
                repr(
                    place.get(graph.parameters[node])
                    if graph.operations[node] == "custom_jvp_node"
                    else graph.parameters[node]
                ),
                str(graph.dtypes[node]),
            )
            for node in nodes
        )
        outputs = tuple((o.shape, tuple(place[int(n)] for n in o.ravel())) for o in self.outputs)
        return lines, outputs, self.shapes, tuple(group.shape for group in self.residuals), self.in_machine_code

    @cached_property
    def _flat(self) -> list[int]:
        return [int(node) for output in self.outputs for node in output.ravel()]

    @cached_property
    def nodes(self) -> list[int]:
        """What is needed, in an order in which it can be evaluated."""
        return self.graph.needed(self._flat, self.flat_residuals)

    @cached_property
    def _with_slopes(self) -> list[int]:
        return self.graph.needed(self._flat, self.flat_residuals, with_slopes=True)

    @cached_property
    def n_operations(self) -> int:
        """How many operations it has."""
        return self.graph.count(self._flat, self.flat_residuals).total()

    @cached_property
    def can_be_called(self) -> bool:
        """Whether there is machine code for all its operations."""
        return can_be_written(self)

    def dtype(self, output: np.ndarray) -> np.dtype:
        """Of the entries of an output."""
        return self.graph.dtypes[int(output.flat[0])] if output.size else FLOAT

    def spread(self, axes: tuple[int, ...]) -> tuple[dict[int, int], tuple[int, ...]]:
        """The axes of all nodes, and of the outputs, for arguments with these axes."""
        if axes not in self._spread:
            self._spread[axes] = self._spread_over(axes)
        return self._spread[axes]

    def _spread_over(self, axes: tuple[int, ...]) -> tuple[dict[int, int], tuple[int, ...]]:
        graph, groups = self.graph, zip(self.residuals, axes[len(self.shapes) :], strict=True)
        of_residuals = {int(node): over for group, over in groups for node in group.ravel()}
        spread: dict[int, int] = {}
        for node in self.nodes:
            # First: a node that comes from outside has the lanes of its argument, whatever it was computed from there.
            if node in of_residuals:
                spread[node] = of_residuals[node]
            elif graph.operations[node] == "input":
                spread[node] = axes[graph.parameters[node][0]]
            else:
                spread[node] = _joined(spread[argument] for argument in graph.arguments[node])
        return spread, tuple(_joined(spread[int(node)] for node in output.ravel()) for output in self.outputs)

    def one_by_one(self, lanes: Shape, axes: tuple[int, ...]) -> Callable[..., list[Array]]:
        """`by_operations` with axes of lanes."""
        function, (_, spread) = self.by_operations, self.spread(axes)
        for axis in range(len(lanes)):  # the mapping that comes last is the outermost, and finds its axis last
            inwards, outwards = ([-1 if over >> axis & 1 else None for over in of_all] for of_all in (axes, spread))
            function = jax.vmap(function, tuple(inwards), outwards)
        return function

    def derivative(self, moves: tuple["ActiveInputs", ...], reads_arguments: bool = False) -> "Derivative":
        """Along tangents of the arguments that move, all of their entries or some.

        With `reads_arguments` coefficients that are entries of arguments are read from these, and not copied: half of
        the time of a product of a matrix with a vector. Only in machine code, where an argument is a pointer.
        """
        key = moves, reads_arguments and self.in_machine_code
        if key not in self._derivatives:
            self._derivatives[key] = self._derived(*key)
        return self._derivatives[key]

    def _derived(self, moves: tuple["ActiveInputs", ...], reads_arguments: bool) -> "Derivative":
        entries = self._entries(moves, self._with_slopes)
        moving = [
            nodes if some is True else [nodes[entry] for entry in some]
            for nodes, some in zip(entries, moves, strict=True)
            if some
        ]
        # The arguments of the line stand behind the tangents among the inputs of the derivative.
        of_values = [self._is_read(i) for i in range(len(moves))] if reads_arguments else [False] * len(moves)
        read_from = _places(self._entries(of_values, self._with_slopes), len(moving))
        forward = Forward(self.graph, self._with_slopes, _places(moving), frozenset(self.flat_residuals), read_from)
        # An output of which some entries move is returned whole, with zeros for the others.
        zero = forward.slopes.constant(0, FLOAT)
        derivatives = [[forward.of(int(node)) for node in output.ravel()] for output in self.outputs]
        follows = tuple(any(slope is not None for slope in of_output) for of_output in derivatives)
        slopes = [
            np.array([zero if slope is None else slope for slope in of_output], np.int64).reshape(output.shape)
            for output, of_output, has_some in zip(self.outputs, derivatives, follows, strict=True)
            if has_some
        ]
        # A coefficient whose products all folded away is not handed over, and an argument that has none is not read.
        needed = set(forward.needed([int(node) for output in slopes for node in output.ravel()]))
        residuals = {node: name for node, name in forward.residuals.items() if name in needed}
        coefficients = grouped([*residuals], forward.values, self.in_machine_code)
        names = [np.array([residuals[int(node)] for node in c.ravel()]).reshape(c.shape) for c in coefficients]
        values = [*self.outputs, *coefficients]
        graph, read = _with_arguments_in_turn(forward.slopes, needed, len(moving))
        # Of an argument of which some entries move, the tangent is the vector of these alone.
        shapes = [
            shape if some is True else (len(some),) for shape, some in zip(self._all_shapes, moves, strict=True) if some
        ]
        shapes += [self._all_shapes[i] for i in read]
        return Derivative(
            StraightLine(forward.values, values, self.shapes, self.residuals, self.in_machine_code),
            StraightLine(graph, slopes, shapes, names, self.in_machine_code),
            follows,
            read,
        )

    def _is_read(self, argument: int) -> bool:
        """Whether a derivative may read an argument: inputs of a line are numbers, and truths are not."""
        of_residual = argument - len(self.shapes)
        return of_residual < 0 or self.dtype(self.residuals[of_residual]) == FLOAT

    @property
    def _all_shapes(self) -> list[Shape]:
        return [*self.shapes, *(group.shape for group in self.residuals)]

    def transposed(self, linear: tuple[bool, ...], has_cotangent: tuple[bool, ...]) -> "StraightLine":
        """Of a line that is linear in some of its arguments: from numbers along its outputs to numbers along these.

        Args:
            linear: which arguments these are.
            has_cotangent: the outputs along which there are numbers, among those that depend on the linear arguments.

        Returns:
            A line whose arguments are the numbers along these outputs, then the arguments that are not linear; its
            outputs belong to the arguments that are.

        Raises:
            NotScalarizable: if it is not linear, as far as its operations show.
        """
        if (linear, has_cotangent) not in self._transposes:
            self._transposes[linear, has_cotangent] = self._made_transpose(linear, has_cotangent)
        return self._transposes[linear, has_cotangent]

    def _made_transpose(self, linear: tuple[bool, ...], has_cotangent: tuple[bool, ...]) -> "StraightLine":
        followed = [*itertools.compress(self.outputs, has_cotangent)]
        inactive = [i for i in range(len(self.shapes)) if not linear[i]]
        # The linear arguments are gone in the new line: numbers below zero, which no argument has, stand for them.
        number = {i: -1 - i for i in range(len(self.shapes))} | {i: at for at, i in enumerate(inactive, len(followed))}
        graph = self.graph.copy(number)
        moving = self._entries(linear, self.nodes)
        along: dict[int, list[tuple[int, int]]] = {}
        for i, output in enumerate(followed):
            for entry, node in enumerate(output.ravel()):
                along.setdefault(int(node), []).append((i, entry))
        # Entries that nothing reads have no node, and the number along them is 0.
        leaves = {node for entries in moving for node in entries if node is not None}
        made = Transposed(graph, self.nodes, leaves, frozenset(self.flat_residuals), along)
        outputs = [
            np.array([made.along(node) for node in entries], np.int64).reshape(shape)
            for entries, shape in itertools.compress(zip(moving, self._all_shapes, strict=True), linear)
        ]
        residuals = [group for i, group in enumerate(self.residuals, len(self.shapes)) if not linear[i]]
        shapes = [*(o.shape for o in followed), *(self.shapes[i] for i in inactive)]
        return StraightLine(graph, outputs, shapes, residuals, self.in_machine_code)

    def _entries(self, chosen: Sequence["ActiveInputs"], nodes: Sequence[int]) -> list[list[int | None]]:
        """The nodes that are the entries of the chosen arguments; None for those that none of `nodes` depends on.

        What only a derivative rule reads is among the nodes of a derivative: a weight, say, of which the value reads
        the acceleration alone, which was evaluated ahead.
        """
        graph, residuals = self.graph, frozenset(self.flat_residuals)
        inputs = {
            graph.parameters[node]: node
            for node in nodes
            if graph.operations[node] == "input" and node not in residuals
        }
        entries: list[list[int | None]] = [
            [inputs.get((i, entry)) for entry in range(int(np.prod(shape)))] if chosen[i] else []
            for i, shape in enumerate(self.shapes)
        ]
        return entries + [
            [int(node) for node in group.ravel()] if chosen[i] else []
            for i, group in enumerate(self.residuals, len(self.shapes))
        ]

    @cached_property
    def by_operations(self) -> Callable[..., list[Array]]:
        """The same as operations of JAX, one by one: what other programs take in, and what runs without a compiler."""

        def evaluated(*arguments: Array) -> list[Array]:
            # The order of arguments is the same everywhere: arrays, then residuals in their groups.
            arrays, residuals = arguments[: len(self.shapes)], arguments[len(self.shapes) :]
            known_values = {}
            for group, x in zip(self.residuals, residuals, strict=True):
                parts = [x] if group.shape == () else jax.lax.split(x, [1] * group.size)
                known_values.update(zip(map(int, group.ravel()), (part.reshape(()) for part in parts), strict=True))
            values = self.graph.emit(self._flat, _reader(arrays), known_values)
            return [self._assembled(output, values) for output in self.outputs]

        # Traced once for all its uses: within another program JAX takes it in as one call, and evaluated it is
        # compiled.
        return jax.jit(evaluated)

    def _assembled(self, output: np.ndarray, values: dict) -> Array:
        if output.size == 0:
            return jnp.zeros(output.shape)
        parts = [jnp.asarray(values[int(node)], self.dtype(output)) for node in output.ravel()]
        return parts[0].reshape(output.shape) if len(parts) == 1 else jnp.stack(parts).reshape(output.shape)


def grouped(nodes: Sequence[int], graph: Graph, in_vectors: bool) -> list[np.ndarray]:
    """Nodes as they are passed between lines: each alone, or in one vector for each type of numbers."""
    if not in_vectors:
        return [np.array(node) for node in nodes]
    # A dictionary for its order, by which the caller finds the groups again.
    kinds = dict.fromkeys(graph.dtypes[node] for node in nodes)
    return [np.array([node for node in nodes if graph.dtypes[node] == kind]) for kind in kinds]


ActiveInputs = bool | tuple[int, ...]
"""Of an argument: whether it has a tangent, or which of its entries have; then its tangent is the vector of theirs."""


class Derivative(NamedTuple):
    """The derivative of a line along tangents of some of its arguments.

    Attributes:
        values: the line, with the coefficients of the derivative as further outputs.
        slopes: the derivative, from the tangents and the coefficients; linear in the tangents.
        follows: which outputs have one; `slopes` has the outputs for these.
        read: arguments of the line that `slopes` takes too, between the tangents and the coefficients.
    """

    values: StraightLine
    slopes: StraightLine
    follows: tuple[bool, ...]
    read: tuple[int, ...] = ()


def _places(arguments: Sequence[Sequence[int | None]], begin: int = 0) -> dict[int, tuple[int, int]]:
    """The argument, counted from `begin`, and the entry of each node that is one."""
    places = {}
    for argument, nodes in enumerate(arguments, begin):
        places.update((node, (argument, entry)) for entry, node in enumerate(nodes) if node is not None)
    return places


def _with_arguments_in_turn(graph: Graph, needed: Collection[int], n_tangents: int) -> tuple[Graph, tuple[int, ...]]:
    """A graph that reads tangents and arguments behind them, with the arguments numbered without gaps; and which."""
    inputs = {graph.parameters[node][0] for node in range(len(graph.operations)) if graph.operations[node] == "input"}
    used = {graph.parameters[node][0] for node in needed if graph.operations[node] == "input"}
    read = sorted(i for i in used if i >= n_tangents)
    number = dict(zip(read, range(n_tangents, n_tangents + len(read)), strict=True))
    if any(old != new for old, new in number.items()):
        # What nothing needs keeps an input, with a number below zero, which no argument has.
        unread = {i: i if i < n_tangents else -1 - i for i in inputs}
        graph = graph.copy({**unread, **number})
    return graph, tuple(i - n_tangents for i in read)


def _reader(flat: Sequence[Array]) -> Callable:
    """A function that reads entries of flat arguments by position; an argument is taken apart once, when it is read.

    By one operation for all its entries: in reverse mode their derivatives are then put together by one as well, and
    not summed from as many arrays of its size.
    """
    entries: dict = {}

    def read(position):
        argument, index = position
        if argument not in entries:
            array = flat[argument].reshape(-1)
            entries[argument] = jax.lax.split(array, [1] * array.size)
        return entries[argument][index].reshape(())

    return read


def _joined(sets: Iterable[int]) -> int:
    return reduce(or_, sets, 0)


# Rules ----------------------------------------------------------------------------------------------------------------


def _shaped(*avals: Any, line: StraightLine, lanes: Shape, axes: tuple[int, ...]) -> list[ShapedArray]:
    # The shapes follow from the line; those of the arguments were checked by whoever made the call.
    del avals
    _, spread = line.spread(axes)
    return [
        ShapedArray((*output.shape, *sizes(lanes, over)), line.dtype(output))
        for output, over in zip(line.outputs, spread, strict=True)
    ]


def _batched(arguments: Sequence, dims: Sequence, *, line: StraightLine, lanes: Shape, axes: tuple[int, ...]):
    """One more axis of lanes, behind those that are there; one lane needs no axis.

    With axes of one lane XLA turns what is spread over lanes into changes of shape, and evaluates what lies behind each
    of them again; `benchmarks/derivative_programs.py` counts it.
    """
    n = next(x.shape[dim] for x, dim in zip(arguments, dims, strict=True) if dim is not None)
    if n == 1:
        alone = [x if dim is None else jnp.squeeze(x, dim) for x, dim in zip(arguments, dims, strict=True)]
        results = _straight_line.bind(*alone, line=line, lanes=lanes, axes=axes)
        return [jnp.expand_dims(x, 0) for x in results], [0] * len(results)
    if lanes and is_called(line, lanes):  # machine code has one axis of lanes: the longer one
        if lanes[0] >= n:
            return by_a_loop(partial(_straight_line.bind, line=line, lanes=lanes, axes=axes), arguments, dims)
        now = tuple(int(dim is not None) for dim in dims)
        (_, was), (_, new) = line.spread(axes), line.spread(now)
        return inside_a_loop(
            partial(_straight_line.bind, line=line, lanes=(n,), axes=now), arguments, dims, axes, was, new
        )
    # The new axis goes last: arguments that were mapped before keep theirs where they are.
    last = 1 << len(lanes)
    turned = [x if dim is None else jnp.moveaxis(x, dim, -1) for x, dim in zip(arguments, dims, strict=True)]
    now = tuple(over if dim is None else over | last for over, dim in zip(axes, dims, strict=True))
    results = _straight_line.bind(*turned, line=line, lanes=(*lanes, n), axes=now)
    _, spread = line.spread(now)
    return results, [x.ndim - 1 if over & last else None for x, over in zip(results, spread, strict=True)]


def _differentiated(primals: Sequence, tangents: Sequence, *, line: StraightLine, lanes: Shape, axes: tuple[int, ...]):
    """The values with the coefficients of the derivative, and what is linear in the tangents."""
    # Numbers without a derivative (truths, whole numbers) may come with a tangent of type float0.
    moves = tuple(
        type(t) is not ad.Zero and jax.typeof(x).dtype == FLOAT for x, t in zip(primals, tangents, strict=True)
    )
    derivative = line.derivative(moves, reads_arguments=True)
    results = _straight_line.bind(*primals, line=derivative.values, lanes=lanes, axes=axes)
    values, coefficients = results[: len(line.outputs)], results[len(line.outputs) :]
    _, spread = derivative.values.spread(axes)
    # A coefficient has the lanes of what it was computed from, a tangent those of its argument.
    over = *itertools.compress(axes, moves), *(axes[i] for i in derivative.read), *spread[len(line.outputs) :]
    along = [*itertools.compress(tangents, moves), *(primals[i] for i in derivative.read)]
    slopes = _straight_line.bind(*along, *coefficients, line=derivative.slopes, lanes=lanes, axes=over)
    _, narrow = derivative.slopes.spread(over)
    wide = itertools.compress(spread, derivative.follows)
    # JAX wants a tangent of the shape of its value, also where it is the same in all lanes.
    moved = iter(widened(*slope, lanes) for slope in zip(slopes, narrow, wide, strict=True))
    return values, [
        next(moved) if follows else ad.Zero(jax.typeof(value).to_tangent_aval())
        for value, follows in zip(values, derivative.follows, strict=True)
    ]


def _transposed(cotangents: Sequence, *arguments: Any, line: StraightLine, lanes: Shape, axes: tuple[int, ...]) -> list:
    """Of a program that is linear in some of its arguments."""
    linear = tuple(ad.is_undefined_primal(x) for x in arguments)
    _, follow = line.spread(tuple(map(int, linear)))
    has_cotangent = tuple(depends > 0 and type(x) is not ad.Zero for x, depends in zip(cotangents, follow, strict=True))
    _, spread = line.spread(axes)
    # What comes back is summed over the lanes that an argument does not have. So the cotangent of an output without
    # these lanes is put into the first of them alone, and counts once.
    own = [(x, has) for x, has, is_followed in zip(cotangents, spread, has_cotangent, strict=True) if is_followed]
    widest = _joined(has for _, has in own)
    along = [in_first_lanes(x, has, widest, lanes) for x, has in own]
    stays = [not moves for moves in linear]
    inactive = [*itertools.compress(arguments, stays)]
    back = line.transposed(linear, has_cotangent)
    over = *(widest for _ in along), *itertools.compress(axes, stays)
    _, back_over = back.spread(over)
    parts_of_all = _straight_line.bind(*along, *inactive, line=back, lanes=lanes, axes=over)
    parts = iter(
        widened(narrowed(x, has, has & wanted), has & wanted, wanted, lanes)
        for x, has, wanted in zip(parts_of_all, back_over, itertools.compress(axes, linear), strict=True)
    )
    return [next(parts) if moves else None for moves in linear]


def _lowered(context: Any, *arguments: Any, line: StraightLine, lanes: Shape, axes: tuple[int, ...]) -> list:
    return Writer(context, line, lanes, axes, arguments).written()


def _lowered_for_processor(
    context: Any, *arguments: Any, line: StraightLine, lanes: Shape, axes: tuple[int, ...]
) -> Sequence:
    several_results.mark(context)
    # Small lines are faster within what XLA compiles around them than behind a call.
    if not is_called(line, lanes):
        return _lowered(context, *arguments, line=line, lanes=lanes, axes=axes)
    name = machine_code.called(line, lanes, axes)
    return jax.ffi.ffi_lowering(name)(context, *arguments)


SMALLEST_CALLED = 100
"""Operations of a line that is worth a call; one costs XLA some 50 ns."""

OVER_LANES = 10
"""So many times more operations has one over lanes to have: what is around it is kernels of XLA's, which it parts."""


def is_called(line: StraightLine, lanes: Shape) -> bool:
    """Whether a line is machine code of its own, and not part of what XLA compiles."""
    if not line.in_machine_code or len(lanes) > 1 or 0 in lanes or not machine_code.is_available():
        return False
    return line.n_operations >= SMALLEST_CALLED * (OVER_LANES if lanes else 1) and line.can_be_called


def _now(*arguments: Any, line: StraightLine, **how: Any) -> list[Array]:
    if private.is_jit_disabled():  # then there is nobody to write for
        return line.one_by_one(**how)(*arguments)
    # One `jax.jit` for each set of lanes: a new one each time would trace and compile each time.
    key = tuple(how.items())
    if key not in line._jitted:
        line._jitted[key] = jax.jit(partial(_straight_line.bind, line=line, **how))
    return line._jitted[key](*arguments)


_straight_line = Primitive("straight_line")
_straight_line.multiple_results = True
_straight_line.def_impl(_now)
_straight_line.def_abstract_eval(_shaped)
batching.primitive_batchers[_straight_line] = _batched
ad.primitive_jvps[_straight_line] = _differentiated
ad.primitive_transposes[_straight_line] = _transposed
several_results.attach()
mlir.register_lowering(_straight_line, _lowered)
mlir.register_lowering(_straight_line, _lowered_for_processor, platform="cpu")
