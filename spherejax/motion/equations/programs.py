"""Functions of a system as programs: clear array code on one side, what the integrator calls on the other.

Every function of a system, time and state is written as array code `function(system, t, y)`. A `Program` evaluates
it on the flat parameter vector theta as a straight-line scalar program, made once for each structure and kept. A system
too large for that runs on the array code, which is mapped over all bodies and all joints of a kind (`path_of`); so does
a law without a scalar program, with a warning.
"""

import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters.partial_eval import dce_jaxpr

from spherejax.compiler import ArrayProgram, NotScalarizable, ScalarProgram, native_code, scalarize
from spherejax.model.groups import joints_by_kind, stacks_from
from spherejax.model.system import Structure, System, example_of
from spherejax.motion.equations.dynamics import state_rate
from spherejax.program_cache import disk_cache, gc_paused


class ArrayPathWarning(UserWarning):
    """A scene runs on array code, which is right but may be several times slower than a scalar program."""


SystemFunction = Callable[[System, jax.Array, Any], object]
Sizes = int | tuple[int, ...] | None

LARGEST_SCALAR_PROGRAM, LARGEST_IN_MACHINE_CODE = 20_000, 40_000
"""Scalar operations up to which a scalar program is made without being asked for: where XLA compiles it, and where it
becomes machine code.

Measured on chains and loops (`benchmarks/scaling.py`). By XLA 13,000 operations compile in 5 s and take 3 us, 28,000 in
14 s and 7 us, 71,000 in 144 s and 138 us, for then they do not fit in the caches of instructions; the array code of any
of these compiles in 2 s, and takes 6, 10 and 27 us. In machine code first calls (processor time, with the array code's
behind) take 8 and 13 s with 25,000 operations, 11 and 14 with 38,000, 15 and 16 with 51,000, gradients 31 and 86 s with
25,000; runs take as long as on array code up to 38,000 operations, those of closed loops half of that, and a third more
with 51,000. Array code was XLA's then. As machine code it compiles sooner with 25,000: 7 and 11 s, gradients 16 and 34
(on a busy machine). A run takes as long as by scalar programs, its gradient up to twice that: single runs are made by
it from `SMALLEST_ALONE` on. Many runs at once go by XLA still, which takes up to nine times as long."""

LARGEST_IN_SUMS = 300_000
"""Scalar operations that may be in long sums of products besides, as those of a network's weights: machine code has
them in loops, whose text is no longer for more of them.

To make a program of them takes 30 us for each. A run with a force by 66,817 weights (134,000 operations) takes 0.28 ms,
on array code 13 ms (`benchmarks/many_numbers.py`)."""

SMALLEST_ALONE, ALIKE = 14_000, 8
"""A single run is on array code from so many scalar operations on, and from so many joints of each kind: the text of
array code grows with the kinds, and not with the joints.

A chain of 12 bodies has so many. With 20 bodies the first call of a run takes 3 s of processor time on array code and 6
on the scalar program, that of a gradient by one mass 8 and 25; a run then takes 14 and 15 ms, a gradient 37 and 28
(`benchmarks/first_calls_of_chains.py --both`)."""

MOST_ROWS_ALONE = 8
"""Derivatives by so many numbers of a single run are on array code with it, which takes one after the other."""


def largest_scalar_program() -> int:
    """Which of these limits holds in this process."""
    return LARGEST_IN_MACHINE_CODE if native_code.is_available() else LARGEST_SCALAR_PROGRAM


LARGEST_COMPUTED = 60_000
"""Scalar operations up to which a program is made that is computed once and not compiled.

It takes 60 us to make one of them; the array code of a film that is pressed to its wall (20,000) takes 11 s to compile,
operation by operation."""


class Program:
    """A function of a system as a callable `program(theta, t, y)`.

    Attributes:
        scalar: the scalar program, or None on the array path.
        too_large: on the array path by itself, for a scalar program would be too large to compile.
    """

    def __init__(
        self,
        function: SystemFunction,
        structure: Structure,
        use_scalars: bool | None,
        y_size: Sizes,
        n_ahead: int,
        is_quiet: bool,
        is_computed: bool = False,
        largest: int | None = None,
    ):
        self.function = function
        self.structure = structure
        self.is_computed = is_computed
        self.scalar: ScalarProgram | None = None
        self.too_large = False
        self._array_programs: dict = {}
        if use_scalars is False:
            return
        try:
            usual = LARGEST_COMPUTED if is_computed else largest_scalar_program()
            limit = None if use_scalars else largest or usual
            self.scalar = _scalar_program(function, structure, y_size, n_ahead, limit, is_computed)
        except NotScalarizable as reason:
            self.too_large = reason.is_too_large
            if is_quiet or self.too_large:
                return
            disk_cache.note_warning()
            warnings.warn(
                f"{function.__name__} runs as array code, which may be several times slower than a scalar program: "
                f"{reason}. Write the law with elementwise operations, jnp.where, dot, cross and tables (jnp.interp) "
                "to get the fast path, or pass scalar=False to silence this.",
                ArrayPathWarning,
                stacklevel=2,
            )

    @cached_property
    def reads_time(self) -> bool:
        """Whether time enters by itself; of array code as far as its operations show, without their numbers."""
        return self._reads(_TIME)

    @cached_property
    def reads_parameters(self) -> bool:
        """Whether any parameter enters; of array code as `reads_time`."""
        return self._reads(_PARAMETERS)

    def _reads(self, argument: int) -> bool:
        if self.scalar is not None:
            return self.scalar.reads(argument)
        theta, number, state = _shapes(self.structure, None)
        traced = jax.make_jaxpr(self)(theta, number, state).jaxpr
        _, is_read = dce_jaxpr(traced, [True] * len(traced.outvars))
        return is_read[argument]

    @cached_property
    def can_be_transposed(self) -> bool:
        """Whether JAX takes derivatives in reverse mode: not of array code with `jax.lax.while_loop`, as a user's law
        may have that solves an equation."""
        if self.scalar is not None:
            return True
        theta, number, state = _shapes(self.structure, None)

        def back(theta, t, y):
            return jax.vjp(lambda theta, y: self(theta, t, y), theta, y)[1](y)

        try:
            jax.eval_shape(back, theta, number, state)
        except (NotImplementedError, TypeError, ValueError):
            return False
        return True

    @cached_property
    def numbers_read(self) -> np.ndarray | None:
        """Indices of the parameters that it depends on; None of array code."""
        return None if self.scalar is None else self.scalar.entries_read(0)

    def ahead(self, *leading):
        """What depends on the leading arguments (the parameters first) alone, evaluated once; pass it to `inside`."""
        if self.scalar is not None:
            self._require_slopes()
            return self.scalar.ahead(*leading)
        return stacks_from(self.structure, leading[0])

    def native_code(self, enabled: bool = True) -> AbstractContextManager:
        """A context in which what is traced of this program becomes machine code, where that can be."""
        return native_code(enabled)

    def inside(self, theta, ahead, t, y) -> Any:
        """As a call, inside a loop over which the leading arguments (the parameters) are constant."""
        if self.scalar is not None:
            return self.scalar.inside(ahead, theta, jnp.asarray(t, jnp.float64), y)
        return self._by_arrays(theta, ahead, t, y)

    def compute(self, theta, t, y) -> Any:
        """Evaluate concrete numbers now, as NumPy, without compiling anything where there is a scalar program."""
        if self.scalar is not None:
            return self.scalar.compute(theta, t, y)
        with jax.ensure_compile_time_eval():
            return jax.tree.map(np.asarray, self._compiled(*jax.tree.map(jnp.asarray, (theta, float(t), y))))

    def __call__(self, theta, t, y) -> Any:
        """Evaluate at parameters theta, time t [s] and flat state y."""
        if self.scalar is not None:
            self._require_slopes()
            return self.scalar(theta, jnp.asarray(t, jnp.float64), y)
        return self._by_arrays(theta, None, t, y)

    def _require_slopes(self) -> None:
        assert not self.is_computed, f"{self.function.__name__} has no derivative rules, and is to be computed only"

    def _by_arrays(self, theta, stacks, t, y) -> Any:
        """The array code; as machine code where that is wanted and can be."""
        if native_code.is_enabled():
            arguments, tree = jax.tree.flatten((theta, stacks, t, y))
            arrays = [jnp.asarray(x, jnp.float64) for x in arguments]
            program, outputs = self._array_program(tree, tuple(x.shape for x in arrays))
            if program.can_be_called:
                return jax.tree.unflatten(outputs, program(*arrays))
        if stacks is None:
            stacks = stacks_from(self.structure, theta)
        return self._as_arrays(self.structure.system(theta), stacks, t, y)

    def _array_program(self, tree: Any, shapes: tuple) -> tuple[ArrayProgram, Any]:
        if (tree, shapes) not in self._array_programs:
            outputs: list = []

            def of_arrays(*arrays: Any) -> list:
                theta, stacks, t, y = jax.tree.unflatten(tree, arrays)
                if stacks is None:
                    stacks = stacks_from(self.structure, theta)
                leaves, form = jax.tree.flatten(self._as_arrays(self.structure.system(theta), stacks, t, y))
                outputs.append(form)
                return leaves

            examples = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
            self._array_programs[tree, shapes] = ArrayProgram.of(of_arrays, *examples), outputs[0]
        return self._array_programs[tree, shapes]

    def _as_arrays(self, system: System, stacks, t, y) -> Any:
        system = eqx.tree_at(lambda s: s.stacks, system, stacks, is_leaf=lambda x: x is None)
        return self.function(system, jnp.asarray(t, jnp.float64), y)

    @cached_property
    def _compiled(self):
        return jax.jit(self)


def dependence(function: Callable, *examples: Any) -> np.ndarray:
    """Which results of a function (rows, flat) depend on which entries of its first argument (columns, flat)."""
    return scalarize(function, *examples).dependence(0)


def program_for(
    function: SystemFunction,
    structure: Structure,
    use_scalars: bool | None = None,
    y_size: Sizes = None,
    n_ahead: int = 1,
    *,
    is_quiet: bool = False,
    is_computed: bool = False,
    largest: int | None = None,
) -> Program:
    """The program of a function for a structure, made on first use and kept.

    Args:
        function: array code `function(system, t, y)`.
        structure: what the program is compiled for.
        use_scalars: True makes a scalar program of any size, False keeps the array code, None makes a scalar program of
            up to `largest_scalar_program()` operations.
        y_size: length of the function's third argument, or lengths if it is a tuple; None for a flat state.
        n_ahead: number of leading arguments that `Program.ahead` is given: 1 for the parameters alone.

    Other args:
        is_quiet: say nothing where a law has no scalar program.
        is_computed: only `Program.compute` is going to be called. A scalar program is made of up to
            `LARGEST_COMPUTED` operations then, without what derivative rules would give.
        largest: another limit than the usual one.
    """
    return made_program(function, structure, use_scalars, y_size, n_ahead, is_quiet, is_computed, largest)


@lru_cache(maxsize=256)
def made_program(*what) -> Program:
    """Behind `program_for`: to `lru_cache` an argument that is left out and its default are two programs."""
    with gc_paused():
        return Program(*what)


def _scalar_program(
    function: SystemFunction, structure: Structure, y_size: Sizes, n_ahead: int, limit: int | None, is_computed: bool
) -> ScalarProgram:
    shapes, number, state = _shapes(structure, y_size)

    def of_numbers(theta, t, y):
        return function(structure.system(theta), t, y)

    of_numbers.__name__ = function.__name__
    fixed = {(0, index): value for index, value in structure.special}
    sizes = jax.tree.map(lambda x: x.shape, state)
    in_sums = LARGEST_IN_SUMS if native_code.is_available() and not is_computed else 0
    key = disk_cache.key_for("scalar program", function, structure, sizes, n_ahead, limit, in_sums, is_computed)
    made = partial(
        scalarize, of_numbers, shapes, number, state, fixed=fixed, n_ahead=n_ahead, maximum_operations=limit,
        maximum_in_sums=in_sums, has_slopes=not is_computed,
    )  # fmt: skip
    return disk_cache.load_or_make(key, made, ScalarProgram)


def _shapes(structure: Structure, y_size: Sizes) -> tuple[Any, Any, Any]:
    """Of the three arguments of a program."""
    size = sum(int(np.prod(shape)) for shape in structure.shapes)
    number = jax.ShapeDtypeStruct((), jnp.float64)
    shapes = jax.ShapeDtypeStruct((size,), jnp.float64)
    if y_size is None:
        y_size = example_of(structure).layout.size
    sizes = y_size if isinstance(y_size, tuple) else (y_size,)
    vectors = tuple(jax.ShapeDtypeStruct((size,), jnp.float64) for size in sizes)
    return shapes, number, vectors if isinstance(y_size, tuple) else vectors[0]


_PARAMETERS, _TIME = 0, 1
"""Places of theta and t among the arguments of a program."""


# Which path -----------------------------------------------------------------------------------------------------------


class ChosenPath(NamedTuple):
    """A path and the reason for it.

    Attributes:
        scalar: what `program_for` is told: None for scalar programs that are not too large, True for scalar programs,
            False for array code.
        reason: one sentence; empty for the usual path.
        alone_on_arrays: whether a single run by an explicit method is on array code all the same.
    """

    scalar: bool | None
    reason: str
    alone_on_arrays: bool = False


def path_of(structure: Structure, asked: bool | None = None) -> ChosenPath:
    """The path of a system, as asked for, or array code where its right-hand side is too large a scalar program."""
    if asked is not None:
        return ChosenPath(asked, "scalar program: as asked for" if asked else "array code: as asked for")
    if not program_for(state_rate, structure).too_large:
        return _path_of_usual_size(structure)
    return ChosenPath(
        False,
        f"array code over bodies and joints of a kind: more than {largest_scalar_program()} scalar operations would "
        "take long to compile. For many runs give scalar=True: a longer first call, and runs up to nine times shorter",
    )


def _path_of_usual_size(structure: Structure) -> ChosenPath:
    scalar = program_for(state_rate, structure).scalar
    if scalar is None or scalar.n_operations < SMALLEST_ALONE:
        return ChosenPath(None, "")
    if not (native_code.is_available() and _is_of_like_joints(structure)):
        return ChosenPath(None, "")
    return ChosenPath(
        None,
        "array code over bodies and joints of a kind, for a single run by an explicit method: its scalar program of "
        f"{scalar.n_operations:,} operations would take longer to compile. Many runs at once (jax.vmap, sj.sweep) and "
        f"derivatives by more than {MOST_ROWS_ALONE} numbers are on that scalar program",
        alone_on_arrays=True,
    )


def _is_of_like_joints(structure: Structure) -> bool:
    """Whether the array code of a system is short: an open chain or tree of many joints of few kinds.

    Closed loops take twice as long on array code, and contacts are not written as machine code.
    """
    system = example_of(structure)
    if len(system.joints) > len(system.bodies) or system.contact_joints or system.touching_forces:
        return False
    n_kinds = len(joints_by_kind(structure)) + len(system.forces)
    return len(system.joints) + len(system.forces) >= ALIKE * n_kinds
