"""A loop of a single run as one function of machine code, with all that is done in a turn.

XLA calls a kernel for each few operations of a loop that calls machine code, and compiles each of them: half of a first
call of a dry joint, and a sixth of its run time. A run on its own is a few arrays and many numbers. Here its loop is
written in LLVM's language as a whole: loops and branches as they are, operations by their records, and calls of other
machine code (stages of a step, and loops that have become machine code before) by the frame that XLA would give them.

What has no rule is left to XLA, as a whole loop (`loop_fusion`).
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.ffi
import numpy as np
from jax.core import ShapedArray, Tracer
from jax.extend import core as jex
from jax.interpreters import mlir

from spherejax.compiler import private
from spherejax.compiler.array_operations import ARRAY_OPERATIONS, of_constants, written_by_entry
from spherejax.compiler.emit.llvm import FunctionText, head
from spherejax.compiler.emit.llvm_arena import SMALLEST_SHARED, shared_room
from spherejax.compiler.emit.llvm_arrays import (
    BY_SIZE,
    LARGE,
    LARGEST_COPIED,
    LARGEST_STACK,
    ArrayText,
    ChangedInPlaceError,
    InPlace,
    Memory,
    NotWrittenError,
    TooManyEntriesError,
    Value,
    kind_of,
    stored_as,
    within_limits,
)
from spherejax.compiler.emit.llvm_sums import PRODUCTS, DeferredRows
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native import ffi_abi
from spherejax.compiler.native.sums_in_place import NOTHING as NO_SUMS
from spherejax.compiler.native.sums_in_place import SumsInPlace, accumulators_of, only_calls, sums_in_place
from spherejax.compiler.operations import DOUBLE, INNER_PROGRAM, OF_PRIMITIVE, OPERATIONS, Call
from spherejax.compiler.primitive import is_called

LOOP = "loop_in_machine_code"
"""The name of the operation."""

loop_primitive = jex.Primitive(LOOP)
loop_primitive.multiple_results = True


def looped(parameters: Any, values: Sequence[Any]) -> list[Any]:
    """The results of `jax.lax.while_loop`, by one call.

    Args:
        parameters, values: of the operation `while`.

    Raises:
        NotWrittenError: if something in it has no rule.
    """
    # Indices are written into the text, where they say which entries are moved.
    n_constant = parameters["cond_nconsts"] + parameters["body_nconsts"]
    known = {i: np.asarray(x) for i, x in enumerate(values[:n_constant]) if is_index(x) and np.size(x) > 1}
    arrays = [jax.numpy.asarray(x) for i, x in enumerate(values) if i not in known]
    avals = [ShapedArray(x.shape, x.dtype) for x in arrays]
    results = [ShapedArray(v.aval.shape, v.aval.dtype) for v in parameters["body_jaxpr"].jaxpr.outvars]
    written = within_limits(
        lambda limits: LoopText(parameters, avals, results, limits, known).whole(), _large_for(parameters, results)
    )
    return bound(arrays, written, results)


LARGEST_TABLE = 2**16
"""Indices of a constant that is written into the text, at most."""


def is_index(constant: Any) -> bool:
    """Whether a value is known and made of whole numbers or truths: what it is depends on no number of a scene."""
    if isinstance(constant, Tracer) or jax.numpy.size(constant) > LARGEST_TABLE:
        return False
    dtype = jax.numpy.result_type(constant)
    return any(jax.numpy.issubdtype(dtype, kind) for kind in (np.integer, np.bool_))


def bound(arrays: Sequence[Any], written: "WrittenLoop", results: Sequence[Any]) -> list[Any]:
    """The results of a function that is written, from arrays."""
    room = [ShapedArray((written.n_room,), np.float64)] if written.n_room else []
    return loop_primitive.bind(*arrays, written=written, results=(*results, *room))[: len(results)]


def _large_for(parameters: Any, results: Sequence[Any]) -> int:
    """From how many entries on an array is changed in place: more than sums have that the loop carries."""
    n_fixed, body = parameters["body_nconsts"], parameters["body_jaxpr"].jaxpr
    pairs = [(n_fixed + k, k) for k, aval in enumerate(results) if LARGE <= aval.size < LARGEST_COPIED]
    most = max((results[k].size for _, k in accumulators_of(body, pairs, are_summed=True)), default=0)
    large = LARGE
    while large <= most:
        large *= 2
    return large


class WrittenLoop(NamedTuple):
    """The text of a loop.

    Attributes:
        text: of the function.
        called: names of other machine code that it calls.
        in_place: arguments that XLA may give away to be changed in place, each with the result that it becomes.
        n_room: numbers that it has to have room for in one more result, which nobody reads: arrays that it computes
            with and the stack has no room for.
        rooms: those among `in_place` whose numbers nobody reads, neither before nor behind.
    """

    text: str
    called: tuple[str, ...]
    in_place: tuple[tuple[int, int], ...]
    n_room: int = 0
    rooms: tuple[int, ...] = ()


PREFIXES = "spherejaxloop_", "spherejaxloops_", "spherejaxprogram_"
"""Of the names of these functions: of loops, of what calls loops, and of what calls these. Names are loaded in
alphabetical order: each comes behind those that it calls."""


LARGEST_DEFERRED = 2**14
"""Numbers from which rows are evaluated behind a loop, at most: they have to fit the caches and the stack."""

LARGEST_AROUND_ARRAYS = 35_000
"""Lines of a loop that calls array code (`array_programs`), at most. LLVM takes 60 us for each, 3.4 s for 15 bodies
of a chain (54,000), whose loop XLA compiles in 1.2 s and which then runs as fast, for its time goes into what it
calls. That of a dry four-bar (21,000) takes 0.8 s, and its run 28 ms in place of 40."""


@loop_primitive.def_abstract_eval
def _shapes(*_: Any, results: tuple, **__: Any) -> list:
    return list(results)


def _lowered(context: Any, *arguments: Any, written: WrittenLoop, results: tuple) -> Sequence:
    del results
    name = target_of_loop(written)
    machine_code.note_ffi_targets([*written.called, name])
    return jax.ffi.ffi_lowering(name, operand_output_aliases=dict(written.in_place))(context, *arguments)


def target_of_loop(written: WrittenLoop) -> str:
    """The target of a call."""
    prefix = PREFIXES[_depth(written)]
    return machine_code.target_of(written.text, is_wide=False, is_optimised=True, prefix=prefix)


def _depth(written: WrittenLoop) -> int:
    """How many of these functions are called within each other."""
    depths = (1 + i for i, prefix in enumerate(PREFIXES) for name in written.called if name.startswith(prefix))
    return max(depths, default=0)


mlir.register_lowering(loop_primitive, _lowered, platform="cpu")


class LoopText:
    """The text of a loop.

    Args:
        parameters: of the operation `while`.
        avals, results: what its arguments and results are.
        limits: which arrays are changed in place.
        known: constants that are written into the text, by their places among all values that the loop is given; of
            these there are no `avals`.

    Attributes:
        called: names of other machine code that is called.
        in_place: as of `WrittenLoop`.
    """

    def __init__(
        self,
        parameters: Any,
        avals: Sequence[Any],
        results: Sequence[Any],
        limits: InPlace = BY_SIZE,
        known: Mapping[Any, Any] = MappingProxyType({}),
    ):
        self.parameters, self.avals, self.results, self._known = parameters, avals, results, known
        # Where arrays are small LLVM finds places for them, and sooner.
        shared = {} if limits.large <= LARGE else {"smallest_shared": SMALLEST_SHARED}
        self.text, self._has_rooms = ArrayText(large=limits.large, **shared), limits.has_rooms
        self._n_room = 0
        self.called: dict[str, None] = {}
        self.in_place: list[tuple[int, int]] = []
        self._calls_arrays = False
        # By the identity of an accumulator's memory: where a call writes what its rows are evaluated from.
        self._vectors: dict[int, Value] = {}
        self._functions: list[str] = []
        self._at_begin: list[str] = []

    def whole(self) -> WrittenLoop:
        """The loop, to be called."""
        text = self.written()
        return WrittenLoop(text, tuple(self.called), tuple(self.in_place), self._n_room)

    def written(self) -> str:
        """The text of a function that XLA calls."""
        text, n_known = self.text, len(self._known)
        given = (self._given(aval, f"%a{i}") for i, aval in enumerate(self.avals))
        values = [
            self.constant(self._known[i]) if i in self._known else next(given) for i in range(len(self.avals) + n_known)
        ]
        n_conditions, n_fixed = self.parameters["cond_nconsts"], self.parameters["body_nconsts"]
        begin = n_conditions + n_fixed
        slots, body = [], self.parameters["body_jaxpr"].jaxpr
        for i, (value, aval) in enumerate(zip(values[begin:], self.results, strict=True)):
            # A large array (samples, steps) is carried where the result belongs, which saves copying it at the end.
            is_room = self._has_rooms and value.size >= SMALLEST_ROOM and _is_room(body, body.invars[n_fixed + i])
            if value.size < text.large and not is_room:
                slots.append(None)
                continue
            slot = Value(aval.shape, value.kind, f"%r{i}", Memory(is_own=True, room=value.size))
            self.in_place.append((begin - n_known + i, i))
            self._copy_elsewhere(value, slot)
            slots.append(slot)
        finals = self.loop(self.parameters, values, slots)
        for i, (value, aval) in enumerate(zip(finals, self.results, strict=True)):
            self._result(value, aval, f"%r{i}")
        return self._with_room()

    def _with_room(self) -> str:
        """The text, with room for its arrays."""
        text, n_results = self.text, len(self.results)
        shared = shared_room(text.shared, text.lines, LARGEST_STACK, f"%r{n_results}")
        self._n_room = -(-shared.n_bytes // 8)
        # Room first: an `alloca` within the loop would take more of the stack in each turn.
        lines = [*text.room, *shared.lines, *self._at_begin, *text.lines, "  ret ptr null", "}", ""]
        begin = head(len(self.avals), n_results + (1 if self._n_room else 0))
        return "\n".join([*text.declared, *text.outside, *self._functions, begin, *lines])

    def _copy_elsewhere(self, source: Value, target: Value) -> None:
        """A large array into its result, unless XLA has made both the same place in memory."""
        text = self.text
        copied, kept = text.new("copied"), text.new("kept")
        is_same = text.made(f"icmp eq ptr {source.name}, {target.name}")
        text.say(f"br i1 {is_same}, label %{kept}, label %{copied}")
        text.lines.append(f"{copied}:")
        text.copy(source, target)
        text.say(f"br label %{kept}")
        text.lines.append(f"{kept}:")

    def _given(self, aval: Any, pointer: str) -> Value:
        kind = kind_of(aval.dtype)
        if not aval.size:
            return Value(aval.shape, kind, "")
        # Whole numbers are computed with 64 bits; JAX has counters and indices of 32.
        if np.dtype(aval.dtype) == np.int32:
            if aval.size > 1:
                raise NotWrittenError("an array of 32-bit numbers that is an argument")
            return Value(
                aval.shape, kind, self.text.made(f"sext i32 {self.text.made(f'load i32, ptr {pointer}')} to i64")
            )
        # Arguments belong to XLA, which may read them again: they are not changed in place.
        value = Value(aval.shape, kind, pointer, Memory(is_own=False))
        if aval.size > 1:
            return value
        # Read as an array of one entry.
        kept = stored_as(kind)
        number = self.text.made(f"load {kept}, ptr {pointer}, align 1")
        return Value(aval.shape, kind, self.text.made(f"trunc i8 {number} to i1") if kind == "i1" else number)

    def _result(self, value: Value, aval: Any, pointer: str) -> None:
        if np.dtype(aval.dtype) == np.int32:
            raise NotWrittenError("32-bit numbers that are returned")
        self.text.copy(value, Value(aval.shape, value.kind, pointer, Memory(is_own=True)))

    # Programs ---------------------------------------------------------------------------------------------------------

    def constant(self, value: Any) -> Any:
        """What stands for a constant."""
        return self.text.known(value)

    def program(
        self, closed: Any, values: Sequence[Value], accumulators: Sequence[tuple[int, int]] = ()
    ) -> list[Value]:
        """The results of a program.

        Args:
            closed: the program.
            values: of its arguments.
            accumulators: arguments that are changed in place, each with the result that it becomes.
        """
        jaxpr, constants = getattr(closed, "jaxpr", closed), getattr(closed, "consts", ())
        environment: dict[Any, Value] = dict(zip(jaxpr.constvars, map(self.constant, constants), strict=True))
        environment.update(zip(jaxpr.invars, values, strict=True))
        return self.evaluated(jaxpr.eqns, jaxpr.outvars, environment, sums_in_place(jaxpr, accumulators))

    def evaluated(
        self,
        equations: Sequence[Any],
        outvars: Sequence[Any],
        environment: dict[Any, Value],
        in_place: SumsInPlace = NO_SUMS,
    ) -> list[Value]:
        """The results of operations, from values by their names."""

        def read(atom: Any) -> Value:
            if not isinstance(atom, jex.Literal):
                return environment[atom]
            aval: Any = atom.aval
            return self.constant(np.asarray(atom.val, aval.dtype))

        for i, equation in enumerate(equations):
            if i in in_place.unread:
                continue
            terms = in_place.terms.get(i, ())
            begins = {term.begin: before for term, before, _ in terms}
            operands = [read(begins.get(k, atom)) for k, atom in enumerate(equation.invars)]
            pairs = [*in_place.passages.get(i, ()), *((term.begin, term.result) for term, *_ in terms)]
            if i in in_place.sums:
                outputs = [self._added(operands, in_place.sums[i])]
            elif equation.primitive.name == "straight_line" and terms:
                outputs = self.adding_line(equation, operands, {term.result: environment[at] for term, at, _ in terms})
            elif pairs:
                outputs = self.changing(equation, operands, pairs)
            else:
                outputs = self.equation(equation, operands)
            environment.update(zip(equation.outvars, outputs, strict=True))
            environment.update((behind, outputs[term.result]) for term, _, behind in terms)
        return [read(atom) for atom in outvars]

    def changing(self, equation: Any, values: list[Value], accumulators: Sequence[tuple[int, int]]) -> list[Value]:
        """The results of an operation with programs inside, of which some change accumulators, as of `program`."""
        name, parameters = equation.primitive.name, equation.params
        if name == "cond":
            return self.branch(
                parameters["branches"], values, [(operand - 1, result) for operand, result in accumulators]
            )
        kept = {result: values[operand] for operand, result in accumulators}
        if name == "scan":
            return self.scan(parameters, values, [out.aval for out in equation.outvars], kept)
        if name == "while":
            return self.loop(parameters, values, [kept.get(k) for k in range(len(equation.outvars))])
        return self.program(parameters[INNER_PROGRAM[name]], values, accumulators)

    def equation(self, equation: Any, values: list[Value]) -> list[Value]:
        """The results of an operation."""
        name, parameters = equation.primitive.name, equation.params
        avals = [out.aval for out in equation.outvars]
        self._calls_arrays = self._calls_arrays or name == "array_program"
        if self._calls_arrays and len(self.text.lines) > LARGEST_AROUND_ARRAYS:
            raise NotWrittenError("a long loop around array code")
        if equation.effects:  # a print or a callback needs JAX's runtime
            raise NotWrittenError(f"the operation {name!r} has an effect")
        known = [self.text.numbers_of(value) for value in values]
        # Indices alone: an array of one number again and again is shorter as a loop.
        if all(array is not None for array in known) and all(aval.dtype != np.float64 for aval in avals):
            arrays = of_constants(name, [np.asarray(x) for x in known], parameters, avals)
            if arrays is not None:
                return [self.constant(np.broadcast_to(x, v.shape)) for x, v in zip(arrays, avals, strict=True)]
        if name in INNER_PROGRAM:
            return self.program(parameters[INNER_PROGRAM[name]], values)
        if name == "while":
            return self.loop(parameters, values, [None] * len(avals))
        if name == "scan":
            return self.scan(parameters, values, avals)
        if name == LOOP:
            return self.other_loop(parameters["written"], values, avals)
        if name == "cond":
            return self.branch(parameters["branches"], values)
        if name == "platform_index":  # of `jax.lax.platform_dependent`: this text is for the CPU alone
            platforms = parameters["platforms"]
            here = next(i for i, names in enumerate(platforms) if names is None or "cpu" in names)
            return [self.text.known(np.int64(here))]
        if name == "straight_line":
            return self.line(parameters, values, avals)
        if name in machine_code.TARGETS:
            return self.call(machine_code.TARGETS[name]([a.aval for a in equation.invars], **parameters), values, avals)
        if (operation := OF_PRIMITIVE.get(name)) is not None:
            return written_by_entry(self.text, operation, values, parameters, avals)
        if (on_arrays := ARRAY_OPERATIONS.get(name)) is not None and on_arrays.llvm is not None:
            return on_arrays.llvm(self.text, values, parameters, avals)
        raise NotWrittenError(f"the operation {name!r} has no rule")

    # Loops and branches -----------------------------------------------------------------------------------------------

    def loop(self, parameters: Any, values: Sequence[Value], slots: Sequence[Value | None]) -> list[Value]:
        """`jax.lax.while_loop`; what is carried is in slots, large arrays in those of their own."""
        text = self.text
        n_conditions, n_fixed = parameters["cond_nconsts"], parameters["body_nconsts"]
        of_condition, fixed, begin = (
            values[:n_conditions],
            values[n_conditions : n_conditions + n_fixed],
            values[n_conditions + n_fixed :],
        )
        carried = [self._slot(value) if slot is None else slot for value, slot in zip(begin, slots, strict=True)]
        # Carried numbers are in memory, not in `phi`s: LLVM makes registers of those that it has room for.
        look, turn, end = (text.new(word) for word in ("look", "turn", "end"))
        text.say(f"br label %{look}")
        text.lines.append(f"{look}:")
        (goes_on,) = self.program(parameters["cond_jaxpr"], [*of_condition, *map(self._held, carried)])
        if goes_on.size != 1:  # `vmap` of a loop makes such conditions; they are for XLA
            raise NotWrittenError("a loop whose lanes end one by one")
        text.say(f"br i1 {text.read(goes_on)}, label %{turn}, label %{end}")
        text.lines.append(f"{turn}:")
        body = parameters["body_jaxpr"]
        accumulators = self._accumulators(body, n_fixed, carried)
        following = self.program(body, [*fixed, *map(self._held, carried)], accumulators)
        self._carry(following, carried)
        text.say(f"br label %{look}")
        text.lines.append(f"{end}:")
        return [self._held(slot) for slot in carried]

    def _accumulators(self, body: Any, n_fixed: int, carried: Sequence[Value]) -> list[tuple[int, int]]:
        """Arrays that a loop carries and only adds to, as of `program`.

        They are added in place: written elsewhere, they would have to be copied to their slots in each turn.
        """
        pairs = [
            (n_fixed + k, k)
            for k, slot in enumerate(carried)
            if 1 < slot.size < self.text.large and slot.kind == DOUBLE
        ]
        return accumulators_of(body.jaxpr, pairs)

    def _added(self, operands: Sequence[Value], accumulator: int) -> Value:
        """A sum of two arrays, in the place of one of them."""
        into = operands[accumulator]
        call = Call((into.kind, into.kind), into.kind, {})

        def write(width: int, *names: str) -> str:
            return OPERATIONS["add"].in_llvm(self.text.at(width), call, *names)

        self.text.entrywise(into.shape, into.kind, operands, write, into=into)
        return self.text.changed(into)

    def _slot(self, value: Value) -> Value:
        """Where a loop carries a value: a large array stays where it is."""
        if not value.size:
            return value
        if self.text.stays(value):
            return self.text.changed(value)
        # A copy, because the loop writes to its slots, and the value may still be read behind it.
        slot = self.text.array(value.shape, value.kind)
        self.text.copy(value, slot)
        return slot

    def _held(self, slot: Value) -> Value:
        """What is in a slot now."""
        if not slot.size or slot.memory is None:
            return slot
        # Versions are counted while the text is written: whoever still reads an older one is refused (`checked`).
        slot = slot._replace(version=slot.memory.version)
        if slot.size > 1:
            return slot
        kept = stored_as(slot.kind)
        number = self.text.made(f"load {kept}, ptr {slot.name}, align 1")
        if slot.kind == "i1":
            number = self.text.made(f"trunc i8 {number} to i1")
        return Value(slot.shape, slot.kind, number)

    def _carry(self, following: Sequence[Value], carried: Sequence[Value]) -> None:
        """What the next turn begins with; nothing is overwritten that is still to be read."""
        # A value that stands in a slot of this loop (x, y = y, x) would be overwritten before it is copied.
        places = {id(slot.memory) for slot in carried}
        safe = []
        for value, slot in zip(following, carried, strict=True):
            if value.size != slot.size:
                raise NotWrittenError("a loop that carries another shape")
            if value.size <= 1 or value.name == slot.name or id(value.memory) not in places:
                safe.append(value)
                continue
            if self.text.stays(value):
                raise ChangedInPlaceError("an array that changes its place")
            apart = self.text.array(value.shape, value.kind)
            self.text.copy(value, apart)
            safe.append(apart)
        for value, slot in zip(safe, carried, strict=True):
            if value.size:
                self.text.checked(value)
                self.text.copy(value, slot)

    def scan(
        self,
        parameters: Any,
        values: Sequence[Value],
        avals: Sequence[Any],
        kept: Mapping[int, Value] = MappingProxyType({}),
    ) -> list[Value]:
        """`jax.lax.scan`, as a loop that counts; of what it carries, accumulators that are kept where they are."""
        text, n = self.text, parameters["length"]
        n_fixed, n_carried = private.counts_of_scan(parameters)
        fixed, begin, columns = values[:n_fixed], values[n_fixed : n_fixed + n_carried], values[n_fixed + n_carried :]
        carried = [kept[k] if k in kept else self._slot(value) for k, value in enumerate(begin)]
        rows = [self._room(aval) for aval in avals[n_carried:]]
        # In memory, as all that is carried; see `loop`.
        counter = text.array((), "i64")
        text.say(f"store i64 0, ptr {counter.name}, align 8")
        if n == 0:  # the loop below looks at its counter after the first turn
            return [*map(self._held, carried), *rows]
        turn, end = text.new("turn"), text.new("end")
        text.say(f"br label %{turn}")
        text.lines.append(f"{turn}:")
        i = text.made(f"load i64, ptr {counter.name}, align 8")
        at = text.made(f"sub i64 {n - 1}, {i}") if parameters["reverse"] else i
        slices = [self._row(column, at) for column in columns]
        body = parameters["jaxpr"]
        accumulators = self._accumulators(body, n_fixed, carried)
        deferred = self._deferred_rows(body.jaxpr, accumulators, n)
        vectors = {k: text.array((n, rows.size), "double") for k, rows in deferred.items()}
        self._vectors.update((id(carried[k].memory), self._row(vector, at)) for k, vector in vectors.items())
        outputs = self.program(body, [*fixed, *map(self._held, carried), *slices], accumulators)
        for k in vectors:
            del self._vectors[id(carried[k].memory)]
        for row, value in zip(rows, outputs[n_carried:], strict=True):
            if value.size:
                # At the index of the slices, of which the last one is the first turn where a scan is reversed.
                place = text.made(f"mul nsw i64 {at}, {value.size}")
                text.put(row, place, np.arange(value.size), value)
        self._carry(outputs[:n_carried], carried)
        following = text.made(f"add nsw i64 {i}, 1")
        text.say(f"store i64 {following}, ptr {counter.name}, align 8")
        text.say(f"br i1 {text.made(f'icmp slt i64 {following}, {n}')}, label %{turn}, label %{end}")
        text.lines.append(f"{end}:")
        for k, vector in vectors.items():
            self._add_products(deferred[k], vector, carried[k])
        return [*map(self._held, carried), *(self._held(row) for row in rows)]

    def _deferred_rows(self, jaxpr: Any, accumulators: Sequence[tuple[int, int]], n: int) -> dict[int, DeferredRows]:
        """Rows of accumulators that are added behind a scan of n turns, all turns at once."""
        deferred = {}
        for k, (equation, result) in only_calls(jaxpr, accumulators).items():
            line, lanes, axes = (equation.params[name] for name in ("line", "lanes", "axes"))
            rows = FunctionText(line, lanes, axes).deferred_rows(result)
            if rows is not None and n * rows.size <= LARGEST_DEFERRED:
                deferred[k] = rows
        return deferred

    def _add_products(self, rows: DeferredRows, vectors: Value, accumulator: Value) -> None:
        """All turns of rows, added to an accumulator."""
        text, (n, size) = self.text, vectors.shape
        text.declared[PRODUCTS] = None
        into = text.changed(self._held(accumulator))
        for block in rows.blocks:
            factors, target = text.pointer(vectors, block.place), text.pointer(into, block.entry)
            text.say(
                f"call void @spherejax.products(ptr {factors}, i64 {size}, i64 {n}, ptr {target}, "
                f"i64 {block.stride}, i64 {block.n_rows}, i64 {block.n_columns})"
            )

    def _room(self, aval: Any) -> Value:
        kind = kind_of(aval.dtype)
        return self.text.array(aval.shape, kind) if aval.size else Value(aval.shape, kind, "")

    def _row(self, column: Value, at: str) -> Value:
        shape = column.shape[1:]
        size = int(np.prod(shape, dtype=int))
        if not size:
            return Value(shape, column.kind, "")
        return self.text.picked(column, self.text.made(f"mul nsw i64 {at}, {size}"), np.arange(size).reshape(shape))

    def branch(
        self, branches: Sequence[Any], values: Sequence[Value], accumulators: Sequence[tuple[int, int]] = ()
    ) -> list[Value]:
        """`jax.lax.switch`; accumulators as of `program`."""
        text, (which, *operands) = self.text, values
        # A constant is written as its digits: no other branch is written then.
        if which.name.lstrip("-").isdigit():
            at = int(which.name)
            return self.program(branches[at if 0 <= at < len(branches) else -1], operands, accumulators)
        index = text.read(which)
        labels, end = [text.new("branch") for _ in branches], text.new("end")
        # The last branch is the default: an index outside takes it, as in StableHLO.
        cases = " ".join(f"i64 {i}, label %{label}" for i, label in enumerate(labels[:-1]))
        text.say(f"switch i64 {index}, label %{labels[-1]} [{cases}]")
        in_place = {argument for argument, _ in accumulators}
        changeable = [v for k, v in enumerate(operands) if text.stays(v) or k in in_place]
        memories = {id(v.memory): v.memory for v in changeable if v.memory is not None}
        before = {key: memory.version for key, memory in memories.items()}
        latest = dict(before)
        outs: list[list[Value]] = []
        targets: list[Value | None] = []
        for label, closed in zip(labels, branches, strict=True):
            text.lines.append(f"{label}:")
            # Each branch begins with the arrays as they were; behind all of them an array counts as changed if it was
            # changed in any.
            for key, memory in memories.items():
                memory.version = before[key]
            outputs = self.program(closed, operands, accumulators)
            if not targets:
                kept = {result for _, result in accumulators}
                targets = [
                    None if text.stays(v) or not v.size or k in kept else text.array(v.shape, v.kind)
                    for k, v in enumerate(outputs)
                ]
            for value, target in zip(outputs, targets, strict=True):
                if target is not None:
                    text.copy(text.checked(value), target)
            outs.append(outputs)
            for key, memory in memories.items():
                latest[key] = max(latest[key], memory.version)
            text.say(f"br label %{end}")
        text.lines.append(f"{end}:")
        for key, memory in memories.items():
            memory.version = latest[key]
        merged = []
        for at, target in enumerate(targets):
            if target is not None:
                merged.append(self._held(target))
                continue
            first = outs[0][at]
            if first.size and any(out[at].name != first.name for out in outs):
                too_many = first.size >= text.large
                raise (TooManyEntriesError if too_many else ChangedInPlaceError)("branches that return other arrays")
            merged.append(first._replace(version=first.memory.version) if first.memory else first)
        return merged

    # Calls ------------------------------------------------------------------------------------------------------------

    def line(self, parameters: Any, values: Sequence[Value], avals: Sequence[Any]) -> list[Value]:
        """A scalar program: machine code of its own, or a function of this text."""
        line, lanes, axes = (parameters[name] for name in ("line", "lanes", "axes"))
        if is_called(line, lanes):
            return self.call(machine_code.called(line, lanes, axes), values, avals)
        # Too small for a call of its own: as a function of this text LLVM may inline it.
        # A function has one loop over lanes, at most.
        if len(lanes) > 1 or 0 in lanes or not line.can_be_called:
            raise NotWrittenError("a scalar program that is none of machine code")
        name = f"line{len(self._functions)}"
        declared, function = FunctionText(line, lanes, axes).written_inside(name)
        # Sorted, for a set has another order in each process, and the text's digest is its name.
        self.text.declared.update(dict.fromkeys(sorted(declared)))
        self._functions.append(function)
        results = [self._room(aval) for aval in avals]
        pointers = [self._address(value) for value in values] + [result.name or "null" for result in results]
        self.text.say(f"call void @{name}({', '.join(f'ptr {pointer}' for pointer in pointers)})")
        return [self._held(result) for result in results]

    def adding_line(self, equation: Any, values: Sequence[Value], into: Mapping[int, Value]) -> list[Value]:
        """A scalar program that is called, and adds some of its results to accumulators."""
        parameters = equation.params
        line, lanes, axes = (parameters[name] for name in ("line", "lanes", "axes"))
        vectors = {k: self._vectors[id(into[k].memory)] for k in sorted(into) if id(into[k].memory) in self._vectors}
        target = machine_code.called(line, lanes, axes, tuple(sorted(into)), tuple(vectors))
        avals = [out.aval for out in equation.outvars]
        further = [ShapedArray(vector.shape, np.float64) for vector in vectors.values()]
        in_place = [*(into.get(k) for k in range(len(avals))), *vectors.values()]
        return self.call(target, values, [*avals, *further], in_place)[: len(avals)]

    def other_loop(self, written: WrittenLoop, values: Sequence[Value], avals: Sequence[Any]) -> list[Value]:
        """A loop that has become machine code before; its large arrays stay where they are, and it changes them."""
        if _depth(written) + 1 >= len(PREFIXES):
            raise NotWrittenError("loops within loops within loops")
        self.called.update(dict.fromkeys(written.called))
        results: list[Value | None] = [None] * len(avals)
        given = [*values]
        for argument, result in written.in_place:
            value = values[argument]
            if not self.text.stays(value):  # somebody may read it again
                value = self._slot(value)
            if value.memory is None or not value.memory.is_own:
                raise ChangedInPlaceError("a loop that changes an array of somebody else")
            results[result], given[argument] = value, value
        return self.call(target_of_loop(written), given, avals, results)

    def call(
        self, name: str, values: Sequence[Value], avals: Sequence[Any], in_place: Sequence[Value | None] | None = None
    ) -> list[Value]:
        """Machine code that XLA could call as well: it finds what it needs in a frame.

        Args:
            name: of its target.
            values: its arguments.
            avals: what its results are.
            in_place: arrays that become results, each in place of its own; None for those that get room.
        """
        text = self.text
        self.called[name] = None
        text.declared[f"declare ptr @{name}(ptr)"] = None
        addresses = [*map(self._address, values)]
        kept = in_place or [None] * len(avals)
        results = [
            self._room(aval) if own is None else text.changed(own) for own, aval in zip(kept, avals, strict=True)
        ]
        # The other machine code keeps to XLA's interface, so that the same object code serves both callers.
        frame = self._frame(len(values), len(results))
        for pointers, parts in (
            (frame.arguments, addresses),
            (frame.results, [r.name for r in results]),
        ):
            for pointer, part in zip(pointers, parts, strict=True):
                text.say(f"store ptr {part or 'null'}, ptr {pointer}, align 8")
        # What it returns is null or an error; functions of ours have none.
        text.made(f"call ptr @{name}(ptr {frame.name})")
        return [self._held(result) for result in results]

    def _address(self, value: Value) -> str:
        """Where a value is; a number is put somewhere."""
        if not value.size:
            return "null"
        if value.size > 1:
            return self.text.checked(value).name
        place = self.text.array(value.shape, value.kind)
        self.text.write(place, 0, value.name)
        return place.name

    def _frame(self, n_arguments: int, n_results: int) -> "_Frame":
        """A frame with places for pointers to numbers, made when the function begins."""
        text, begin = self.text, self._at_begin
        # Zeros and tables are written once, ahead of the loop; a call then stores the pointers alone.
        frame = text.new("%frame")
        text.room.append(f"  {frame} = alloca [{ffi_abi.FRAME_WORDS} x i64], align 64")
        text.declared["declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)"] = None
        begin.append(
            f"  call void @llvm.memset.p0.i64(ptr align 8 {frame}, i8 0, i64 {8 * ffi_abi.FRAME_WORDS}, i1 false)"
        )
        places = []
        for offset, n in ((ffi_abi.FRAME_ARGUMENTS, n_arguments), (ffi_abi.FRAME_RESULTS, n_results)):
            table, buffers = text.new("%table"), text.new("%buffers")
            text.room += [
                f"  {table} = alloca [{max(n, 1)} x ptr], align 64",
                f"  {buffers} = alloca [{max(4 * n, 1)} x i64], align 64",  # four words reach up to `data`
            ]
            at = text.new("%at")
            begin += [
                f"  {at} = getelementptr inbounds i8, ptr {frame}, i64 {offset}",
                f"  store ptr {table}, ptr {at}, align 8",
            ]
            data = []
            for i in range(n):
                entry, buffer, number = text.new("%at"), text.new("%at"), text.new("%at")
                begin += [
                    f"  {entry} = getelementptr inbounds ptr, ptr {table}, i64 {i}",
                    f"  {buffer} = getelementptr inbounds i8, ptr {buffers}, i64 {32 * i}",
                    f"  store ptr {buffer}, ptr {entry}, align 8",
                    f"  {number} = getelementptr inbounds i8, ptr {buffer}, i64 {ffi_abi.BUFFER_DATA}",
                ]
                data.append(number)
            places.append(data)
        return _Frame(frame, *places)


BY_ROWS = ("dynamic_slice", "dynamic_update_slice", "gather", "scatter")
"""Operations that read rows of their first argument, or write some."""

SMALLEST_ROOM = 256
"""Entries of an array that stays where it is because it is written and read by rows alone, at least."""


def _is_room(jaxpr: Any, array: Any) -> bool:
    """Whether an argument of a program is written and read by rows alone, as are the results that it becomes."""
    for equation in jaxpr.eqns:
        places = [i for i, atom in enumerate(equation.invars) if atom is array]
        if not places:
            continue
        name = equation.primitive.name
        if name in BY_ROWS:
            within: list | None = [] if places == [0] else None
        elif name == LOOP:
            in_place = dict(equation.params["written"].in_place)
            within = [] if all(i in in_place for i in places) else None
        else:
            within = _inner_arguments(equation, places)
        if within is None or not all(_is_room(*inner) for inner in within):
            return False
        # What is of its kind may be what it has become.
        kind = array.aval.shape, array.aval.dtype
        if not all(_is_room(jaxpr, out) for out in equation.outvars if (out.aval.shape, out.aval.dtype) == kind):
            return False
    return True


def _inner_arguments(equation: Any, places: Sequence[int]) -> list[tuple[Any, Any]] | None:
    """Programs within an operation, with those of their arguments that its arguments at some places are; None where it
    reads whole arrays."""
    name, parameters, pairs = equation.primitive.name, equation.params, []
    for i in places:
        if name in INNER_PROGRAM:
            inner = [(parameters[INNER_PROGRAM[name]], i)]
        elif name == "cond" and i > 0:
            inner = [(branch, i - 1) for branch in parameters["branches"]]
        elif name == "while":
            n_conditions, n_fixed = parameters["cond_nconsts"], parameters["body_nconsts"]
            of_condition, of_body = i, i - n_conditions
            if i >= n_conditions + n_fixed:
                of_condition = i - n_fixed
            inner = [(parameters["body_jaxpr"], of_body)] if of_body >= 0 else []
            is_fixed = n_conditions <= i < n_conditions + n_fixed
            inner += [] if is_fixed else [(parameters["cond_jaxpr"], of_condition)]
        elif name == "scan":
            # The last ones are given to each turn row by row.
            inner = [(parameters["jaxpr"], i)] if i < sum(private.counts_of_scan(parameters)) else []
        else:
            return None
        for program, at in inner:
            jaxpr = getattr(program, "jaxpr", program)
            pairs.append((jaxpr, jaxpr.invars[at]))
    return pairs


class _Frame:
    """A frame of a call: its name, and where pointers to arguments and results go."""

    def __init__(self, name: str, arguments: list[str], results: list[str]):
        self.name, self.arguments, self.results = name, arguments, results
