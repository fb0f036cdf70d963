"""Operations on small arrays in LLVM's language: numbers as they are, arrays in memory, eight entries at a time.

What JAX says of arrays becomes loads, vector operations and stores; LLVM puts together what belongs together. Arrays
are never changed once they are made, but for large ones (`LARGE`), which stay where they are: who reads one that has
changed in the meantime is refused.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from spherejax.compiler.emit.llvm import LANES_AT_A_TIME, Numbers, constant, number_of
from spherejax.compiler.emit.llvm_vectors import spread_out

LARGE = 4096
"""Entries of an array that is changed in place; smaller ones are copied."""

LARGEST_COPIED = 2**18
"""The same limit, of a loop that computes with such arrays entry by entry: derivatives by the weights of a network.

A gradient by 4,417 weights takes two thirds of the time that it takes with a loop of XLA's."""

LARGEST_WRITTEN_OUT = 1024
"""Entries of an array that operations are written out for, at most; for more, and fewer than `LARGE`, there are loops.
With 4,096 written out, a film with three rows of sensitivities takes a third longer to compile for a tenth of its time,
and Andrews' mechanism more of both."""

LARGEST_STACK = 2**19
"""Bytes of arrays on the stack, at most: a thread of XLA's pool has a few megabytes."""

MOST_PIECES = 128
"""Pieces of other arrays that a large one may be moved together from, at most: each is a loop of its own."""


FIRST_BLOCK = "work"
"""The block with which the instructions of a function begin (`ffi_abi.beginning`)."""


class NotWrittenError(Exception):
    """An operation has no rule here; XLA compiles the program instead."""


class TooManyEntriesError(NotWrittenError):
    """An array is too large to be computed entry by entry.

    Attributes:
        size: its entries; 0 where it is no single array.
    """

    def __init__(self, reason: str = "", size: int = 0):
        super().__init__(reason)
        self.size = size


class ChangedInPlaceError(NotWrittenError):
    """An array is read after it was changed, or is not to be changed."""


class InPlace(NamedTuple):
    """Which arrays stay where they are.

    Attributes:
        large: entries of any that does.
        has_rooms: whether those of fewer entries do as well that are written and read by rows alone.
    """

    large: int
    has_rooms: bool


BY_SIZE = InPlace(LARGE, has_rooms=False)
"""Large arrays alone."""


def within_limits(written: Callable[[InPlace], Any], large: int = LARGE) -> Any:
    """What is written with the first limits with which it can be: the fewer arrays are copied the better.

    Args:
        written: writes it.
        large: the first limit.

    Raises:
        NotWrittenError: if there are none.
    """
    limits = InPlace(large, has_rooms=True)
    while True:
        try:
            return written(limits)
        except TooManyEntriesError as too_many:
            # It computes with arrays of thousands of numbers. Those that it changes in place are larger, or it copies
            # them.
            large = 2 * limits.large
            while large <= too_many.size:
                large *= 2
            if large > LARGEST_COPIED:
                raise
            limits = limits._replace(large=large)
        except ChangedInPlaceError:
            if not limits.has_rooms:
                raise
            limits = limits._replace(has_rooms=False)


class Memory:
    """Where an array is.

    Attributes:
        version: how often it was changed in place.
        is_own: whether it may be.
        room: entries of an array that stays where it is, however small; 0 for others.
    """

    def __init__(self, is_own: bool, room: int = 0):
        self.version, self.is_own, self.room = 0, is_own, room


class Value(NamedTuple):
    """An array while the text is written.

    Attributes:
        shape, kind: its shape, and `double`, `i64` or `i1`, as which all numbers are computed.
        name: of its only entry, or of a pointer to the first one; nothing where there is none.
        memory, version: where it is, and what of it.
    """

    shape: tuple[int, ...]
    kind: str
    name: str
    memory: Memory | None = None
    version: int = 0

    @property
    def size(self) -> int:
        """Its number of entries."""
        return int(np.prod(self.shape, dtype=int))

    def as_shape(self, shape: tuple[int, ...]) -> "Value":
        """The same entries in another shape."""
        return self._replace(shape=tuple(shape))


def kind_of(dtype: Any) -> str:
    """As what numbers of a type are computed."""
    try:
        dtype = np.dtype(dtype)
    except TypeError:  # of keys of random numbers, which are no type of NumPy
        raise NotWrittenError(f"numbers of type {dtype}") from None
    if dtype == np.float64:
        return "double"
    # Counters of loops: JAX makes some of 32 bits. All are computed with 64, which gives the same numbers below 2^31.
    if dtype in (np.int64, np.int32):
        return "i64"
    if dtype == np.bool_:
        return "i1"
    raise NotWrittenError(f"numbers of type {dtype}")


def stored_as(kind: str) -> str:
    """How entries of an array are kept in memory."""
    return "i8" if kind == "i1" else kind


class ArrayText:
    """Lines of a function, and what is to be declared outside of it.

    Args:
        largest_written_out, large: see `LARGEST_WRITTEN_OUT` and `LARGE`.
        largest_by_entry: entries of an array that is computed entry by entry, at most; None for less than `large`.
        smallest_shared: bytes of an array that gets no place of its own, at least.

    Attributes:
        shared: bytes of these arrays, by name.
    """

    def __init__(
        self,
        largest_written_out: int = LARGEST_WRITTEN_OUT,
        largest_by_entry: int | None = None,
        smallest_shared: float = math.inf,
        large: int = LARGE,
    ) -> None:
        self.large, self._largest_written_out = large, largest_written_out
        self._largest_by_entry = large - 1 if largest_by_entry is None else largest_by_entry
        self._smallest_shared = smallest_shared
        self.shared: dict[str, int] = {}
        self.lines: list[str] = []
        self.room: list[str] = []
        # A dictionary for its order: the text, whose digest is its name, has to be the same in every process.
        self.declared: dict[str, None] = {}
        self.outside: list[str] = []
        self._n, self._bytes = 0, 0
        self._constants: dict[tuple, Value] = {}
        self._numbers: dict[str, np.ndarray] = {}

    def stays(self, value: Value) -> bool:
        """Whether an array stays where it is; a slice of it is another one."""
        return value.size >= self.large or (value.memory is not None and 1 < value.memory.room == value.size)

    # Lines and memory -------------------------------------------------------------------------------------------------

    def new(self, prefix: str = "%n") -> str:
        """A name that nothing has."""
        self._n += 1
        return f"{prefix}{self._n}"

    def made(self, text: str) -> str:
        """The name of what an instruction gives."""
        name = self.new()
        self.lines.append(f"  {name} = {text}")
        return name

    def say(self, text: str) -> None:
        """An instruction that gives nothing."""
        self.lines.append(f"  {text}")

    def array(self, shape: Sequence[int], kind: str) -> Value:
        """Room on the stack for an array, which belongs to this place in the text."""
        size, name = int(np.prod(shape, dtype=int)), self.new("%m")
        # Never given back: a place in the text is one place in memory, also in a loop, so that all of them add up.
        n_bytes = size * (1 if kind == "i1" else 8)
        if n_bytes >= self._smallest_shared:
            self.shared[name] = n_bytes
            return Value(tuple(shape), kind, name, Memory(is_own=True))
        self._bytes += n_bytes
        if self._bytes > LARGEST_STACK:
            # Where thousands of numbers are computed with, arrays share room, and may have it elsewhere.
            raise TooManyEntriesError("arrays that do not fit the stack")
        self.room.append(f"  {name} = alloca [{max(size, 1)} x {stored_as(kind)}], align 64")
        return Value(tuple(shape), kind, name, Memory(is_own=True))

    def known(self, value: Any) -> Value:
        """A constant."""
        kind = kind_of(value.dtype if hasattr(value, "dtype") else np.result_type(value))
        array = np.asarray(value)
        if array.size == 1:  # stands in the instructions themselves, where LLVM folds it
            return Value(array.shape, kind, constant(array.ravel()[0], kind))
        # By its bytes: 0.0 and -0.0, and NaN, are told apart.
        key = kind, array.shape, array.tobytes()
        if key not in self._constants and array.size:
            name, stored = self.new("@known"), stored_as(kind)
            numbers = (constant(x, "i64" if kind == "i1" else kind) for x in array.ravel())
            entries = ", ".join(f"{stored} {x}" for x in numbers)
            self.outside.append(f"{name} = private constant [{array.size} x {stored}] [{entries}], align 64")
            self._constants[key] = Value(array.shape, kind, name, Memory(is_own=False))
            self._numbers[name] = array
        return self._constants[key] if array.size else Value(array.shape, kind, "")

    def numbers_of(self, value: Value) -> np.ndarray | None:
        """What a constant is; None for what is none."""
        if value.size == 1 and value.name[0] not in "%@":
            return np.reshape(number_of(value.name, value.kind), value.shape)
        array = self._numbers.get(value.name)
        return None if array is None or array.size != value.size else array.reshape(value.shape)

    def checked(self, value: Value) -> Value:
        """A value that is still what it was.

        Raises:
            NotWrittenError: if it was changed in place.
        """
        if value.memory is not None and value.memory.version != value.version:
            raise ChangedInPlaceError("a large array that is read after it was changed")
        return value

    def changed(self, value: Value) -> Value:
        """A large array that is changed in place from here on; who reads what it was is refused.

        Raises:
            NotWrittenError: if it belongs to somebody else.
        """
        memory = self.checked(value).memory
        if memory is None or not memory.is_own:
            raise ChangedInPlaceError("a large array that is not to be changed")
        # Whoever still holds the value of before has the old version, and is refused when it reads.
        memory.version += 1
        return value._replace(version=memory.version)

    def pointer(self, value: Value, at: int | str = 0) -> str:
        """To an entry of an array."""
        if at == 0:
            return value.name
        return self.made(f"getelementptr inbounds {stored_as(value.kind)}, ptr {value.name}, i64 {at}")

    def read(self, value: Value, at: int | str = 0, width: int = 1) -> str:
        """Entries of an array; a number alone for each of them."""
        kind = value.kind
        if value.size == 1:
            return value.name if width == 1 else self.spread(value.name, kind, width)
        self.checked(value)
        # Alignment of one entry, since a chunk may begin at any of them; processors load that as fast.
        typed, kept = (vector(of_kind, width) for of_kind in (kind, stored_as(kind)))
        loaded = self.made(f"load {kept}, ptr {self.pointer(value, at)}, align {1 if kind == 'i1' else 8}")
        return self.made(f"trunc {kept} {loaded} to {typed}") if kind == "i1" else loaded

    def write(self, target: Value, at: int | str, name: str, width: int = 1) -> None:
        """Entries into an array."""
        kind = target.kind
        typed, kept = (vector(of_kind, width) for of_kind in (kind, stored_as(kind)))
        if kind == "i1":
            name = self.made(f"zext {typed} {name} to {kept}")
        self.say(f"store {kept} {name}, ptr {self.pointer(target, at)}, align {1 if kind == 'i1' else 8}")

    def spread(self, name: str, kind: str, width: int) -> str:
        """A number in each entry of a vector."""
        if width == 1:
            return name
        filled, typed = self.new(), vector(kind, width)
        if kind == "double":
            self.lines.append(spread_out(filled, name, typed))
            return filled
        first = self.made(f"insertelement {typed} poison, {kind} {name}, i64 0")
        return self.made(f"shufflevector {typed} {first}, {typed} poison, <{width} x i32> zeroinitializer")

    def copy(self, source: Value, target: Value) -> None:
        """All entries of an array into another one."""
        if source.name == target.name or not source.size:
            return
        if source.size == 1:  # is no array in memory: its name is the number
            self.write(target, 0, source.name)
        elif source.size >= self.large:
            # A call, where vectors would be more than 128 loads and stores in the text.
            self.declared["declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)"] = None
            n = source.size * (1 if source.kind == "i1" else 8)
            self.checked(source)
            self.say(f"call void @llvm.memcpy.p0.p0.i64(ptr align 8 {target.name}, ptr align 8 {source.name}, "
                     f"i64 {n}, i1 false)")  # fmt: skip
        else:
            self.through(source.size, lambda i, width: self.write(target, i, self.read(source, i, width), width))

    def through(self, size: int, write: Callable[[int | str, int], None]) -> None:
        """Instructions for so many entries: written out chunk by chunk, or where they are many as a loop.

        Args:
            size: entries.
            write: from where a chunk begins, and how wide it is.
        """
        n, step = size // LANES_AT_A_TIME, LANES_AT_A_TIME
        if size <= self._largest_written_out:
            n = 0
        else:
            self.counted(n, lambda i: write(self.made(f"mul nsw i64 {i}, {step}"), step))
        for at, width in chunks(size - n * step):
            write(n * step + at, width)

    def counted(self, n: int, write: Callable[[str], None]) -> None:
        """A loop of n turns, at least one; `write` is given the name of what counts them from 0."""
        turn, end, i, before = self.new("turn"), self.new("end"), self.new(), self._block()
        self.say(f"br label %{turn}")
        self.lines.append(f"{turn}:")
        place = len(self.lines)
        write(i)
        following = self.made(f"add nsw i64 {i}, 1")
        # A `phi`, which names the last block of the turn: what counts is in a register without any pass of LLVM.
        self.lines.insert(place, f"  {i} = phi i64 [0, %{before}], [{following}, %{self._block()}]")
        self.say(f"br i1 {self.made(f'icmp slt i64 {following}, {n}')}, label %{turn}, label %{end}")
        self.lines.append(f"{end}:")

    def _block(self) -> str:
        """The name of the block that instructions are added to."""
        return next((line[:-1] for line in reversed(self.lines) if line.endswith(":")), FIRST_BLOCK)

    # Entry by entry ---------------------------------------------------------------------------------------------------

    def entrywise(
        self,
        shape: Sequence[int],
        kind: str,
        values: Sequence[Value],
        write: Callable[..., str],
        into: Value | None = None,
    ) -> Value:
        """An array, a few entries at a time.

        Args:
            shape, kind: of the result.
            values: of this shape, or of one that spreads over it.
            write: from a width and the entries of each value to those of the result.
            into: where it is put, which may be one of the values; None for a place of its own.
        """
        size = int(np.prod(shape, dtype=int))
        if size == 0:
            return Value(tuple(shape), kind, "")
        # Before the loop over chunks: then all arrays have the same entries at the same places.
        values = [self.broadcast(value, shape) for value in values]
        if size == 1:
            return Value(tuple(shape), kind, write(1, *(self.read(value) for value in values)))
        if size > self._largest_by_entry:
            raise TooManyEntriesError(f"an operation on {size} numbers", size)
        target = self.array(shape, kind) if into is None else into

        def write_chunk(at: int | str, width: int) -> None:
            self.write(target, at, write(width, *(self.read(value, at, width) for value in values)), width)

        self.through(size, write_chunk)
        return target

    def broadcast(self, value: Value, shape: Sequence[int]) -> Value:
        """A value in a shape; one number stays alone."""
        if value.size == 1 or value.size == int(np.prod(shape, dtype=int)):
            return value
        places = np.broadcast_to(np.arange(value.size).reshape(value.shape), tuple(shape))
        return self.moved([value], places, value.kind)

    def moved(self, sources: Sequence[Value], entries: np.ndarray, kind: str) -> Value:
        """An array of entries of others, which are counted through; one that stands in one piece stays where it is."""
        flat, begins = entries.ravel(), np.cumsum([0, *(source.size for source in sources)])
        if flat.size == 0:
            return Value(entries.shape, kind, "")
        of = np.searchsorted(begins, flat, side="right") - 1
        within = flat - begins[of]
        first = self.checked(sources[of[0]])
        if flat.size == 1:
            return Value(entries.shape, kind, self.read(first, int(within[0])))
        # Nothing is written for it: most reshapes and slices end here.
        is_whole = np.all(of == of[0]) and np.array_equal(within, within[0] + np.arange(flat.size))
        if is_whole:
            return first._replace(shape=entries.shape, name=self.pointer(first, int(within[0])))
        pieces = _pieces(of, within)
        if flat.size > LARGEST_WRITTEN_OUT and len(pieces) > MOST_PIECES:
            raise NotWrittenError(f"{flat.size} numbers that are moved in {len(pieces)} pieces")
        if flat.size >= self.large:
            raise TooManyEntriesError(f"{flat.size} numbers that are moved", flat.size)
        target = self.array(entries.shape, kind)
        for at, n, step in pieces:
            self.move(sources[of[at]], int(within[at]), step, target, at, n)
        return target

    def move(self, source: Value, begin: int, step: int, target: Value, at: int, n: int) -> None:
        """A piece of an array, or one of its numbers again and again (step 0), into another one from `at` on."""
        # From pointers on: in a loop, places are counted from the first entry of the piece.
        into = target._replace(name=self.pointer(target, at))
        several = source._replace(name=self.pointer(self.checked(source), begin)) if source.size > 1 else source
        one = "" if step else self.read(source, begin)

        def write(place: int | str, width: int) -> None:
            numbers = self.read(several, place, width) if step else self.spread(one, source.kind, width)
            self.write(into, place, numbers, width)

        self.through(n, write)

    def picked(self, source: Value, begin: str, offsets: np.ndarray) -> Value:
        """Entries of an array at distances from one whose place is known when the program runs."""
        flat = offsets.ravel()
        self.checked(source)
        at = source._replace(name=self.pointer(source, begin)) if source.size > 1 else source
        if flat.size == 1 or source.size == 1:
            return Value(offsets.shape, source.kind, self.read(at, int(flat[0])))
        # In one piece, as a slice of rows: nothing is copied, the result is a place in the source.
        if np.array_equal(flat, np.arange(flat.size)):
            return at.as_shape(offsets.shape)
        target = self.array(offsets.shape, source.kind)
        for i, offset in enumerate(flat):
            self.write(target, i, self.read(at, int(offset)))
        return target

    def put(self, target: Value, begin: str, offsets: np.ndarray, source: Value) -> None:
        """The reverse of `picked`, in place."""
        at, flat = target._replace(name=self.pointer(target, begin)), offsets.ravel()
        if np.array_equal(flat, np.arange(flat.size)):
            self.through(flat.size, lambda i, width: self.write(at, i, self.read(source, i, width), width))
            return
        for i, offset in enumerate(flat):
            self.write(at, int(offset), self.read(source, i))

    # Numbers ----------------------------------------------------------------------------------------------------------

    def at(self, width: int) -> "Entries":
        """Writes operations on so many entries at a time."""
        return Entries(self, width)

    def clamped(self, name: str, low: int, high: int) -> str:
        """A whole number within bounds."""
        one = self.at(1)
        return one.intrinsic("smin", "i64", one.intrinsic("smax", "i64", name, str(low)), str(high))

    def folded(self, value: Value, entries: Sequence[int], start: str, join: Callable[..., str]) -> str:
        """Entries of an array put together, in vectors where they stand in one piece.

        Args:
            value, entries: the array, and which of its entries.
            start: what to begin with.
            join: from a width and two names to what they make together.
        """
        total, at, n, step = start, 0, len(entries), LANES_AT_A_TIME
        begin = int(entries[0])
        if n > self._largest_written_out and np.array_equal(entries, begin + np.arange(n)):
            return join(1, total, self._folded_by_a_loop(value, begin, n, join))
        # Eight sums side by side, which are put together at the end: in a chain each sum would wait for the one before.
        # The order of a sum is another one than XLA's; results differ by rounding.
        if n >= step and np.array_equal(entries, begin + np.arange(n)):
            several = self.read(value, begin, step)
            for at in range(step, n - step + 1, step):
                several = join(step, several, self.read(value, begin + at, step))
            total, at = join(1, start, self._across(several, value.kind, join)), n // step * step
        for entry in entries[at:]:
            total = join(1, total, self.read(value, int(entry)))
        return total

    def _folded_by_a_loop(self, value: Value, begin: int, n: int, join: Callable[..., str]) -> str:
        """Entries that stand in one piece, put together in eight sums side by side."""
        step, rest = LANES_AT_A_TIME, n % LANES_AT_A_TIME
        several = self.array((step,), value.kind)
        self.write(several, 0, self.read(value, begin, step), step)

        def add(i: str) -> None:
            at = self.made(f"add nsw i64 {self.made(f'mul nsw i64 {i}, {step}')}, {begin + step}")
            self.write(several, 0, join(step, self.read(several, 0, step), self.read(value, at, step)), step)

        self.counted(n // step - 1, add)
        total = self._across(self.read(several, 0, step), value.kind, join)
        for entry in range(begin + n - rest, begin + n):
            total = join(1, total, self.read(value, entry))
        return total

    def _across(self, name: str, kind: str, join: Callable[..., str]) -> str:
        """The entries of a vector put together, by halves."""
        size = LANES_AT_A_TIME
        while size > 1:
            typed, half = vector(kind, size), size // 2
            places = (", ".join(f"i32 {i}" for i in part) for part in (range(half), range(half, size)))
            parts = [
                self.made(f"shufflevector {typed} {name}, {typed} poison, <{half} x i32> <{part}>") for part in places
            ]
            if half == 1:  # a vector of one is another type than its number
                parts = [self.made(f"extractelement <1 x {kind}> {part}, i64 0") for part in parts]
            name, size = join(half, *parts), half
        return name


def _pieces(of: np.ndarray, within: np.ndarray) -> list[tuple[int, int, int]]:
    """Runs of entries that follow each other (step 1), or are the same one (step 0): begin, length and step of each.

    Args:
        of: which array each entry is of.
        within: its place there.
    """
    pieces, at, size = [], 0, of.size
    while at < size:
        begin, n = within[at], 1
        step = 0 if at + 1 < size and within[at + 1] == begin and of[at + 1] == of[at] else 1
        while at + n < size and of[at + n] == of[at] and within[at + n] == begin + n * step:
            n += 1
        pieces.append((at, n, step))
        at += n
    return pieces


class Entries(Numbers):
    """Writes operations on some entries of an array at a time."""

    def __init__(self, text: ArrayText, width: int):
        super().__init__(text.made, text.declared, width)
        self._text, self._width = text, width

    def number(self, value: Any, kind: str) -> str:
        """A constant; spread by instructions, as all that arrays share is: LLVM sees through them."""
        return self._text.spread(constant(value, kind), kind, self._width)


def vector(kind: str, width: int) -> str:
    """The type of some numbers."""
    return f"<{width} x {kind}>" if width > 1 else kind


def chunks(size: int) -> list[tuple[int, int]]:
    """Where vectors begin that cover so many entries, and how wide they are."""
    return [(at, min(LANES_AT_A_TIME, size - at)) for at in range(0, size, LANES_AT_A_TIME)]
