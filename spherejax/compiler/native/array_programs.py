"""Array code as one function of machine code, whose text does not grow with the arrays.

A scalar program writes out every number of a mechanism; of a hundred bodies that is too long to compile. Array code
maps what is written for one body over all of them. XLA takes a second for each place where such code stands, and an
integration has ten of them. Here it becomes a function of its own, which is compiled once and called from all places:

* what is mapped over things of one kind (`mapped`) is a scalar program over lanes, eight of them at a time;
* what only moves entries is nothing by itself: moves behind one another are one move, through a table of places;
* `block_solve` is a loop over pivots around one scalar program (`eliminations`);
* other operations are loops over entries.

What has no rule here is left as array code, as a whole.
"""

import logging
from collections.abc import Callable, Sequence
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray, Tracer
from jax.extend import core as jex
from jax.interpreters import ad, batching, mlir
from jax.interpreters.partial_eval import dce_jaxpr

from spherejax.compiler.array_operations import (
    ARRAY_OPERATIONS,
    both_arranged,
    gathered,
    of_constants,
    written_by_entry,
)
from spherejax.compiler.emit.llvm import FunctionText, head
from spherejax.compiler.emit.llvm_arena import SMALLEST_SHARED, shared_room
from spherejax.compiler.emit.llvm_arrays import ArrayText, NotWrittenError, Value, kind_of
from spherejax.compiler.lanes import by_a_loop
from spherejax.compiler.linear_algebra.mapping import scalar_programs
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.eliminations import elimination
from spherejax.compiler.native.loops import LoopText
from spherejax.compiler.operations import INNER_PROGRAM, OF_PRIMITIVE, OPERATIONS
from spherejax.compiler.program import scalarize

# The operation --------------------------------------------------------------------------------------------------------


class ArrayProgram:
    """Array code that is machine code where it is called (static: it is compared by its identity).

    Its derivative in forward mode is two of its kind: the values with what the derivative needs, and what is linear in
    the tangents. It has none in reverse mode, which JAX says. Lanes are taken one by one.

    Attributes:
        jaxpr, constants: the code.
        called: the name of its machine code, once there is some.
    """

    def __init__(self, jaxpr: Any, constants: Sequence[Any]):
        self.jaxpr, self.constants = jaxpr, tuple(constants)
        self.called: str | None = None
        self._derivatives: dict[tuple[bool, ...], tuple] = {}
        self._written: tuple[str, tuple[str, ...]] | None = None

    @classmethod
    def of(cls, function: Callable, *examples: Any) -> "ArrayProgram":
        """Array code from shapes of flat arguments to flat results."""
        with machine_code.native_code(True), scalar_programs(scalarize):
            closed = jax.make_jaxpr(function)(*examples)
        jaxpr, _ = dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
        return cls(jaxpr, closed.consts)

    def __call__(self, *arguments: Any) -> list[Any]:
        """Evaluate flat arguments."""
        return _array_program.bind(*arguments, program=self)

    def as_arrays(self, *arguments: Any) -> list[Any]:
        """The same as array code."""
        return jex.jaxpr_as_fun(jex.ClosedJaxpr(self.jaxpr, self.constants))(*arguments)

    def written(self) -> tuple[str, tuple[str, ...]]:
        """The text, and names of other machine code that it calls.

        Raises:
            NotWrittenError: if something in it has no rule.
        """
        if self._written is None:
            text = ProgramText(self.jaxpr, self.constants)
            self._written = text.written(), tuple(text.called)
        return self._written

    @cached_property
    def can_be_called(self) -> bool:
        """Whether all of it has a rule in machine code."""
        try:
            self.written()
        except NotWrittenError as reason:
            logging.getLogger(__name__).info("array code is left to XLA: %s", reason)
            return False
        return True

    def along(self, moves: tuple[bool, ...]) -> tuple["ArrayProgram", "ArrayProgram", int]:
        """The values with what their derivative needs, and the derivative along tangents of the arguments that move."""
        if moves not in self._derivatives:
            self._derivatives[moves] = self._along(moves)
        return self._derivatives[moves]

    def _along(self, moves: tuple[bool, ...]) -> tuple["ArrayProgram", "ArrayProgram", int]:
        avals = [v.aval for v in self.jaxpr.invars]
        handed_on: dict[str, Any] = {}

        def values(*arguments: Any) -> list[Any]:
            def of_moving(*moving: Any) -> list[Any]:
                each = iter(moving)
                return self.as_arrays(*(next(each) if m else x for m, x in zip(moves, arguments, strict=True)))

            results, linear = jax.linearize(of_moving, *(x for m, x in zip(moves, arguments, strict=True) if m))
            # What is constant (indices, mostly) is not handed on.
            leaves, handed_on["tree"] = jax.tree.flatten(linear)
            handed_on["constants"] = {i: x for i, x in enumerate(leaves) if not isinstance(x, Tracer)}
            residuals = [x for i, x in enumerate(leaves) if i not in handed_on["constants"]]
            handed_on["avals"] = [jax.typeof(x) for x in residuals]
            return [*results, *residuals]

        first = ArrayProgram.of(values, *avals)

        def slopes(*both: Any) -> list[Any]:
            n = len(handed_on["avals"])
            residuals, constants = iter(both[:n]), handed_on["constants"]
            leaves = [constants[i] if i in constants else next(residuals) for i in range(n + len(constants))]
            return jax.tree.unflatten(handed_on["tree"], leaves)(*both[n:])

        tangents = [aval for m, aval in zip(moves, avals, strict=True) if m]
        second = ArrayProgram.of(slopes, *handed_on["avals"], *tangents)
        return first, second, len(self.jaxpr.outvars)


_array_program = jex.Primitive("array_program")
_array_program.multiple_results = True


@_array_program.def_abstract_eval
def _shapes(*_: Any, program: ArrayProgram) -> list:
    return [ShapedArray(v.aval.shape, v.aval.dtype) for v in program.jaxpr.outvars]


@_array_program.def_impl
def _evaluated(*arguments: Any, program: ArrayProgram) -> list:
    return jax.jit(partial(_array_program.bind, program=program))(*arguments)


def _differentiated(primals: Sequence, tangents: Sequence, *, program: ArrayProgram) -> tuple[list, list]:
    moves = tuple(
        type(t) is not ad.Zero and jnp.issubdtype(jax.typeof(x).dtype, jnp.floating)
        for x, t in zip(primals, tangents, strict=True)
    )
    values, slopes, n = program.along(moves)
    results = values(*primals)
    return results[:n], slopes(*results[n:], *(t for m, t in zip(moves, tangents, strict=True) if m))


def _batched(arguments: Sequence, dims: Sequence, *, program: ArrayProgram) -> tuple[Sequence, Sequence]:
    n = next(x.shape[dim] for x, dim in zip(arguments, dims, strict=True) if dim is not None)
    if n == 1:
        alone = [x if dim is None else jnp.squeeze(x, dim) for x, dim in zip(arguments, dims, strict=True)]
        results = _array_program.bind(*alone, program=program)
        return [jnp.expand_dims(x, 0) for x in results], [0] * len(results)
    return by_a_loop(partial(_array_program.bind, program=program), arguments, dims)


def _target(avals: Sequence, *, program: ArrayProgram) -> str:
    del avals
    text, called = program.written()
    if program.called is None:
        # Without LLVM's passes, which put the scalar programs into each other: they take four fifths of its time (0.7 s
        # for a chain of 50 bodies), and save 3 to 7 % of the function's.
        program.called = machine_code.target_of(text, is_wide=True, is_optimised=False, prefix=PREFIX)
    machine_code.note_ffi_targets([*called, program.called])
    return program.called


PREFIX = "spherejaxarrays_"


def _lowered(context: Any, *arguments: Any, program: ArrayProgram) -> Sequence:
    if not program.can_be_called:  # the derivative of one that can
        return _lowered_as_arrays(context, *arguments, program=program)
    return jax.ffi.ffi_lowering(_target(context.avals_in, program=program))(context, *arguments)


def _lowered_as_arrays(context: Any, *arguments: Any, program: ArrayProgram) -> Sequence:
    return mlir.lower_fun(program.as_arrays, multiple_results=True)(context, *arguments)


ad.primitive_jvps[_array_program] = _differentiated
batching.primitive_batchers[_array_program] = _batched
machine_code.TARGETS["array_program"] = _target
mlir.register_lowering(_array_program, _lowered_as_arrays)
mlir.register_lowering(_array_program, _lowered, platform="cpu")


# The text -------------------------------------------------------------------------------------------------------------


class Known:
    """A constant while the text is written."""

    def __init__(self, array: Any):
        if jnp.issubdtype(jnp.result_type(array), jax.dtypes.extended):
            raise NotWrittenError("keys of random numbers")
        self.array = np.asarray(array)
        self.shape, self.size = self.array.shape, self.array.size


class Moved:
    """Entries of arrays, counted through all of them, that nobody has read yet."""

    def __init__(self, sources: Sequence[Any], entries: np.ndarray, kind: str):
        self.sources, self.entries, self.kind = sources, entries, kind
        self.shape, self.size = entries.shape, entries.size
        self.made: Value | None = None


REDUCED_BY = {
    "reduce_sum": "add", "reduce_prod": "mul", "reduce_max": "max", "reduce_min": "min", "reduce_and": "and",
    "reduce_or": "or",
}  # fmt: skip
"""By which operation on two numbers an operation puts together entries."""

LARGEST_STACK = 2**20
"""Bytes of arrays of one program, at most: a thread of XLA's pool has a few megabytes."""

LARGEST_WRITTEN_OUT, LARGEST_BY_ENTRY = 64, 2**16
"""Entries of an array that operations are written out for, and those that they are loops for, at most."""


class ProgramText(LoopText):
    """The text of array code."""

    def __init__(self, jaxpr: Any, constants: Sequence[Any]):
        self.jaxpr, self.constants = jaxpr, constants
        avals = [v.aval for v in jaxpr.invars]
        super().__init__(None, avals, [v.aval for v in jaxpr.outvars])
        self.text = ArrayText(LARGEST_WRITTEN_OUT, LARGEST_BY_ENTRY, SMALLEST_SHARED)
        self._lines: dict[str, str] = {}

    def written(self) -> str:
        """The text of a function that XLA calls."""
        text = self.text
        values = [self._given(aval, f"%a{i}") for i, aval in enumerate(self.avals)]
        results = self.program(jex.ClosedJaxpr(self.jaxpr, self.constants), values)
        for i, (value, aval) in enumerate(zip(results, self.results, strict=True)):
            self._result(self.forced(value), aval, f"%r{i}")
        room = [*text.room, *shared_room(text.shared, text.lines, LARGEST_STACK).lines]
        body = [*room, *self._at_begin, *text.lines, "  ret ptr null", "}", ""]
        begin = head(len(self.avals), len(self.results))
        return "\n".join([*text.declared, *text.outside, *self._functions, begin, *body])

    def constant(self, value: Any) -> Any:
        """A constant."""
        return Known(value)

    def program(self, closed: Any, values: Sequence[Any], accumulators: Any = ()) -> list[Any]:
        """The results of a program of a loop or a branch, in memory; accumulators are arrays as all others."""
        del accumulators  # added in place they would have to be written at once, and here a value waits for its reader
        return [self.forced(value) for value in super().program(closed, values)]

    def equation(self, equation: Any, values: list[Any]) -> list[Any]:
        """The results of an operation."""
        name, parameters = equation.primitive.name, equation.params
        avals = [out.aval for out in equation.outvars]
        if name in INNER_PROGRAM:
            return super().program(parameters[INNER_PROGRAM[name]], values)
        rule = ARRAY_OPERATIONS.get(name)
        are_known = all(isinstance(value, Known) for value in values)
        if rule is not None and rule.moves is not None and not are_known:
            return self._moves(rule.moves, values, parameters, avals)
        if name == "gather" and isinstance(values[1], Known):
            indices = values[1].array

            def taken(arrays: Sequence[np.ndarray], parameters: Any) -> list[np.ndarray]:
                return [gathered(arrays[0], indices, parameters)]

            return self._moves(taken, values[:1], parameters, avals)
        if are_known and (known := of_constants(name, [value.array for value in values], parameters, avals)):
            return [Known(np.broadcast_to(x, aval.shape)) for x, aval in zip(known, avals, strict=True)]
        if name == "block_solve":
            return [self.block_solve([self.forced(value) for value in values], parameters, avals[0])]
        if name in REDUCED_BY and values[0].size > LARGEST_WRITTEN_OUT:
            return [self.reduced(REDUCED_BY[name], values[0], parameters["axes"], avals[0])]
        if name == "dot_general" and max(value.size for value in values) > LARGEST_WRITTEN_OUT:
            return [self.product(values, parameters, avals[0])]
        if name in OF_PRIMITIVE:
            (aval,) = avals
            values = [
                value if value.size in (1, aval.size) else self._moves(_spread_to, [value], aval.shape, [aval])[0]
                for value in values
            ]
        return super().equation(equation, [self.forced(value) for value in values])

    # What puts entries together -------------------------------------------------------------------------------------

    def reduced(self, by: str, value: Any, axes: Sequence[int], aval: Any) -> Any:
        """Entries put together along some axes: halves of what is left, again and again."""
        count = int(np.prod([value.shape[axis] for axis in axes], dtype=int))

        def in_rows(arrays: Sequence[np.ndarray], _: Any) -> list[np.ndarray]:
            kept = [axis for axis in range(arrays[0].ndim) if axis not in axes]
            return [arrays[0].transpose([*axes, *kept]).reshape(count, -1)]

        dtype, width = aval.dtype, aval.size
        (rows,) = self._moves(in_rows, [value], None, [jax.ShapeDtypeStruct((count, width), dtype)])
        if not count or not width:
            raise NotWrittenError("a sum of nothing")
        while count > 1:
            half, rest = divmod(count, 2)

            def halves(arrays: Sequence[np.ndarray], half: int = half) -> list[np.ndarray]:
                return [arrays[0][:half], arrays[0][half : 2 * half], arrays[0][2 * half :]]

            shapes = [jax.ShapeDtypeStruct((n, width), dtype) for n in (half, half, rest)]
            rows = self.forced(rows)
            one, other, last = self._moves(lambda arrays, _, halves=halves: halves(arrays), [rows], None, shapes)
            pair = [self.forced(one), self.forced(other)]
            (rows,) = written_by_entry(self.text, OPERATIONS[by], pair, {}, shapes[:1])
            count = half + rest
            if rest:
                shapes = [jax.ShapeDtypeStruct((count, width), dtype)]
                (rows,) = self._moves(lambda arrays, _: [np.concatenate(arrays)], [rows, last], None, shapes)
        return self.forced(rows).as_shape(aval.shape)

    def product(self, values: Sequence[Any], parameters: Any, aval: Any) -> Any:
        """A product of matrices, as sums of products."""
        if aval.dtype != np.float64:
            raise NotWrittenError("a product of whole numbers")
        a, b = both_arranged([np.zeros(value.shape, bool) for value in values], parameters)
        shape = a.shape[0], a.shape[1], b.shape[1], a.shape[2]

        def side_by_side(arrays: Sequence[np.ndarray], parameters: Any) -> list[np.ndarray]:
            a, b = both_arranged(arrays, parameters)
            return [np.broadcast_to(a[:, :, None], shape), np.broadcast_to(b[:, None], shape)]

        whole = jax.ShapeDtypeStruct(shape, np.float64)
        factors = [self.forced(x) for x in self._moves(side_by_side, values, parameters, [whole, whole])]
        products = written_by_entry(self.text, OPERATIONS["mul"], factors, {}, [whole])
        return self.reduced("add", products[0], (3,), aval)

    # Moves ------------------------------------------------------------------------------------------------------------

    def _moves(self, moves: Callable, values: Sequence[Any], parameters: Any, avals: Sequence[Any]) -> list[Any]:
        sources: list[Any] = []
        begins: list[int] = []
        at: dict[int, int] = {}
        total = 0

        def begin_of(source: Any) -> int:
            nonlocal total
            key = id(source)
            if key not in at:
                at[key] = total
                sources.append(source)
                begins.append(total)
                total += source.size
            return at[key]

        places = []
        for value in values:
            if isinstance(value, Moved) and value.made is None:
                starts = np.array([begin_of(source) for source in value.sources])
                ends = np.cumsum([0, *(source.size for source in value.sources)])
                of = np.searchsorted(ends, value.entries, side="right") - 1
                places.append(value.entries - ends[of] + starts[of])
            else:
                source: Any = value.made if isinstance(value, Moved) else value
                places.append(begin_of(source) + np.arange(source.size).reshape(value.shape))
        moved = []
        for entries, aval in zip(moves(places, parameters), avals, strict=True):
            entries = np.broadcast_to(entries, aval.shape)
            if np.any(entries < 0):
                raise NotWrittenError("a gather with an index out of range")
            moved.append(self._pruned(sources, begins, entries, kind_of(aval.dtype)))
        return moved

    @staticmethod
    def _pruned(sources: Sequence[Any], begins: Sequence[int], entries: np.ndarray, kind: str) -> Moved:
        """Without sources that nothing is taken of."""
        if not entries.size:
            return Moved([], entries, kind)
        of = np.searchsorted(begins, entries, side="right") - 1
        # An empty source begins where the next one does.
        used = np.unique(of)
        sizes = [sources[i].size for i in used]
        starts = np.zeros(len(sources), int)
        starts[used] = np.cumsum([0, *sizes])[:-1]
        return Moved([sources[i] for i in used], entries - np.asarray(begins)[of] + starts[of], kind)

    def forced(self, value: Any) -> Value:
        """A value as it is in memory."""
        if isinstance(value, Known):
            return self.text.known(value.array)
        if not isinstance(value, Moved):
            return value
        if value.made is None:
            value.made = self._made(value)
        return value.made

    def placed(self, moves: Callable, values: Sequence[Any]) -> Value:
        """What moves give of arrays and constants, in memory of its own."""
        given = [Known(value) if isinstance(value, np.ndarray) else value for value in values]
        shape = moves([np.zeros(value.shape, int) for value in given], None)[0].shape
        (value,) = self._moves(moves, given, None, [jax.ShapeDtypeStruct(shape, np.float64)])
        return self._filled(value)

    def _made(self, value: Moved) -> Value:
        text, flat = self.text, value.entries.ravel()
        if flat.size == 0:
            return Value(value.shape, value.kind, "")
        sources = [self.forced(source) for source in value.sources]
        if flat.size <= 16 or (len(sources) == 1 and np.array_equal(flat, flat[0] + np.arange(flat.size))):
            return text.moved(sources, value.entries, value.kind)
        return self._filled(value)

    def _filled(self, value: Moved) -> Value:
        text, flat = self.text, value.entries.ravel()
        sources = [self.forced(source) for source in value.sources]
        target = text.array(value.shape, value.kind)
        begins = np.cumsum([0, *(source.size for source in sources)])
        of = np.searchsorted(begins, flat, side="right") - 1
        for i, source in enumerate(sources):
            to = np.flatnonzero(of == i)
            self._transfer(source, flat[to] - begins[i], target, to)
        return target

    def _transfer(self, source: Value, within: np.ndarray, target: Value, to: np.ndarray) -> None:
        """Entries of an array to places in another one."""
        text, n = self.text, to.size
        one = text.read(source) if source.size == 1 else None
        goes_on = np.array_equal(to, to[0] + np.arange(n))
        if goes_on and n >= 8 and (one is not None or np.array_equal(within, within[0] + np.arange(n))):
            text.move(source, int(within[0]), 0 if one is not None else 1, target, int(to[0]), n)
            return
        if n <= 8:
            for a, b in zip(within, to, strict=True):
                text.write(target, int(b), one or text.read(source, int(a)))
            return
        origins = source if one else text.known(within.astype(np.int64))
        places = target if goes_on else text.known(to.astype(np.int64))

        def write(i: str) -> None:
            number = one or text.read(source, text.read(origins, i))
            place = text.made(f"add nsw i64 {i}, {int(to[0])}") if goes_on else text.read(places, i)
            text.write(target, place, number)

        text.counted(n, write)

    # Calls ------------------------------------------------------------------------------------------------------------

    def function(self, line: Any, lanes: tuple[int, ...], axes: tuple[int, ...]) -> str:
        """The name of a function of this text for a scalar program."""
        declared, function = FunctionText(line, lanes, axes).written_inside("NAME")
        if function not in self._lines:
            name = self._lines[function] = f"line{len(self._functions)}"
            self.text.declared.update(dict.fromkeys(sorted(declared)))
            self._functions.append(function.replace("@NAME(", f"@{name}("))
        return self._lines[function]

    def line(self, parameters: Any, values: Sequence[Value], avals: Sequence[Any]) -> list[Value]:
        """A scalar program, as a function of this text."""
        line, lanes, axes = (parameters[name] for name in ("line", "lanes", "axes"))
        if len(lanes) > 1 or 0 in lanes or not line.can_be_called:
            raise NotWrittenError("a scalar program that is none of machine code")
        name = self.function(line, lanes, axes)
        results = [self._room(aval) for aval in avals]
        pointers = [self._address(value) for value in values] + [result.name or "null" for result in results]
        self.text.say(f"call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})")
        return [self._held(result) for result in results]

    def block_solve(self, values: Sequence[Value], parameters: Any, aval: Any) -> Value:
        """A linear system of blocks."""
        if len(aval.shape) != 3:
            raise NotWrittenError("several systems of blocks")
        return elimination(self, values, **parameters)


def _spread_to(inputs: Sequence[np.ndarray], shape: Any) -> list[np.ndarray]:
    return [np.broadcast_to(inputs[0], shape)]
