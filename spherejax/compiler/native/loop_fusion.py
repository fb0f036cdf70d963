"""What lies between the calls of machine code in a loop, as few kernels.

The loop of a single run is machine code as a whole, where all that is done in it has a rule (`loops`). Any other loop
that calls something is not one native function: XLA walks through its operations, at some 50 ns for each fusion and
each copy, hundreds of them in a step. Here the operations of such a loop's body are put in an order in which as many as
possible stand together, and what stands together becomes a function that XLA compiles as one kernel, as it does itself
with a small loop.

XLA does so for a function with the attribute `xla_cpu_small_call`. It aborts the process where such a function has an
argument that nothing reads (jaxlib 0.10), which a simplification may bring about at any time. Therefore each function
returns one number of each of its arguments, too; nobody looks at them. And XLA is not told what is known when a
loop begins: it would write that into the functions, and leave those arguments unread.
"""

import logging
import math
from collections.abc import Callable, Sequence
from functools import cache, wraps
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray
from jax.extend import core as jex
from jax.extend.mlir import ir
from jax.interpreters import batching, mlir

from spherejax.compiler import private, several_results
from spherejax.compiler.array_operations import ARRAY_OPERATIONS
from spherejax.compiler.emit.llvm_arrays import NotWrittenError
from spherejax.compiler.native import compile as machine_code
from spherejax.compiler.native.loops import LOOP, looped
from spherejax.compiler.operations import INNER_PROGRAM, OF_PRIMITIVE, inner_program
from spherejax.compiler.primitive import is_called

SMALLEST_KERNEL = 2
"""Operations that are worth a function; XLA makes about one kernel of fewer by itself."""

LARGEST_JOINED = 2048
"""Entries of an array that a kernel may make, at most: it cannot change one in place, as XLA itself does with samples
and steps that a loop writes down, but copies it."""

LARGEST_SUMMED = 1024
"""Entries of an array that a kernel may sum up, at most. XLA hands large sums to a library (YNNPACK), also within a
function that is to be one kernel, and then has no way to write it: of 4,840 entries, not of 2,080 (jaxlib 0.10.2)."""

LARGEST_PART = 64
"""Entries of an array that is passed on as a part of a vector, at most."""


_FUSED = frozenset([
    *OF_PRIMITIVE, *(name for name, operation in ARRAY_OPERATIONS.items() if operation.fuses), *INNER_PROGRAM,
    "straight_line", "while", "scan", "cond", "platform_index",
    "maybe_set", "select_if_vmap", "unvmap_any", "unvmap_all", "unvmap_max",  # of equinox
])  # fmt: skip
"""Operations that a kernel may have. Of others XLA calls a library, or has no way to write them into a function: they
stand alone, and so does what has an effect."""


def changed(function: Callable, evaluated: Callable[[Any, Sequence], Sequence]) -> Callable:
    """The same function where no machine code is made; elsewhere its program is evaluated in another way.

    Args:
        function: not to be differentiated: rules that are attached to parts of it are lost.
        evaluated: from a program and flat arguments to flat results. The program is traced, and evaluated operation by
            operation, so that loops are seen before JAX lowers them.
    """

    @wraps(function)
    def made(*arguments: Any) -> Any:
        if not machine_code.native_code_enabled():
            return function(*arguments)
        closed, shapes = jax.make_jaxpr(function, return_shape=True)(*arguments)
        results = evaluated(closed, jax.tree.leaves(arguments))
        return jax.tree.unflatten(jax.tree.structure(shapes), results)

    return made


def fuse_loops(function: Callable) -> Callable:
    """The same function; loops in it that call machine code do the rest of each turn in few kernels.

    Not to be differentiated, see `changed`.
    """
    return changed(function, lambda closed, values: _evaluated(closed.jaxpr, closed.consts, values, is_loop=False))


def whole_loops(function: Callable) -> Callable:
    """The same function; its loops that call machine code become machine code as a whole where all in them has a rule.

    Others stay as they are: XLA (jaxlib 0.10) aborts the process over some branches of derivatives between kernels.
    Loops within other operations are not looked for. Not to be differentiated, see `changed`.
    """
    return changed(function, _with_whole_loops)


def _with_whole_loops(closed: Any, values: Sequence) -> list:
    jaxpr = closed.jaxpr
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*closed.consts, *values], strict=True))
    for equation in jaxpr.eqns:
        results = None
        if equation.primitive.name == "while" and _calls(equation) and _is_alone(equation):
            results = _as_a_whole(equation, [_read(atom, known) for atom in equation.invars])
        if results is None:
            inputs = [*dict.fromkeys(a for a in equation.invars if isinstance(a, jex.Var))]
            one = _as_function([equation], inputs, equation.outvars)
            results = one(*(known[a] for a in inputs))
        known.update(zip(equation.outvars, results, strict=True))
    return [_read(atom, known) for atom in jaxpr.outvars]


def _calls(equation: Any) -> bool:
    """Whether machine code is called in an operation."""
    if equation.primitive.name == "straight_line":
        return is_called(equation.params["line"], equation.params["lanes"])
    if equation.primitive.name in machine_code.TARGETS or equation.primitive.name == LOOP:
        return True
    return any(_calls(e) for inner in jex.jaxprs_in_params(equation.params) for e in inner.eqns)


def _is_alone(equation: Any) -> bool:
    """Whether the machine code that is called in an operation is for one run, not for many in lanes."""
    if equation.primitive.name in machine_code.TARGETS:
        return equation.params.get("n_runs") is None
    return all(_is_alone(e) for inner in jex.jaxprs_in_params(equation.params) for e in inner.eqns)


def _reduces(name: str) -> bool:
    """Whether an operation may be handed to a library where it is large."""
    return name in ARRAY_OPERATIONS and ARRAY_OPERATIONS[name].reduces


def _joins(equation: Any) -> bool:
    """Whether an operation may be part of a kernel."""
    if equation.effects or _calls(equation):
        return False
    if any(getattr(out.aval, "size", 0) > LARGEST_JOINED for out in equation.outvars):
        return False
    if _reduces(equation.primitive.name) and any(a.aval.size > LARGEST_SUMMED for a in equation.invars):
        return False
    if equation.primitive.name == "scatter":  # in one place: to XLA an update of a slice
        return math.prod(equation.invars[1].aval.shape[:-1]) == 1
    if equation.primitive.name not in _FUSED:
        return False
    return all(_joins(e) for inner in jex.jaxprs_in_params(equation.params) for e in inner.eqns)


def _evaluated(jaxpr: Any, constants: Sequence, arguments: Sequence, is_loop: bool) -> list:
    """The results of a program; in a loop its operations stand together where they can."""
    known: dict[Any, Any] = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))
    waiting = [(equation, _joins(equation)) for equation in jaxpr.eqns]
    # By turns: all that is ready and may stand together becomes one kernel, then all calls that are ready are made. So
    # as few kernels as possible lie between two calls.
    while waiting:
        together, left = [], []
        ready = set(known)
        for equation, joins in waiting:
            if joins and _is_ready(equation, ready):
                together.append(equation)
                ready.update(equation.outvars)
            else:
                left.append((equation, joins))
        # What a call reads is passed on by itself; what other kernels read may be packed into vectors.
        later = {a for e, joins in left for a in e.invars if joins and isinstance(a, jex.Var)}
        whole = {a for e, joins in left for a in e.invars if not joins and isinstance(a, jex.Var)}
        whole.update(a for a in jaxpr.outvars if isinstance(a, jex.Var))
        _make(together, whole, later, known, is_loop)
        waiting = []
        for equation, joins in left:
            if not joins and _is_ready(equation, known):
                _call(equation, known, is_loop)
            else:
                waiting.append((equation, joins))
        # A program is in an order in which it can be evaluated, so that its first operation is always ready.
        assert together or len(waiting) < len(left), "a program that waits for itself"
    return [_read(atom, known) for atom in jaxpr.outvars]


def _is_ready(equation: Any, known: Any) -> bool:
    return all(isinstance(atom, jex.Literal) or atom in known for atom in equation.invars)


class _VectorPart(NamedTuple):
    """A small array as a part of a vector.

    Every argument of a kernel costs time, and so does every array that a loop carries, which XLA copies.
    """

    vector: Any
    begin: int
    shape: tuple[int, ...]

    def taken(self, vector: Any) -> Any:
        """The array, out of its vector."""
        end = self.begin + math.prod(self.shape)
        return jax.lax.slice(vector, (self.begin,), (end,)).reshape(self.shape)


def _parts(avals: Sequence[tuple[Any, Any]]) -> list[list[tuple[Any, int, tuple[int, ...]]]]:
    """Small arrays of a kind put together: of each its name, where it begins, and its shape.

    Args:
        avals: names and what they stand for.
    """
    kinds: dict[Any, list] = {}
    for name, aval in avals:
        if 0 < aval.size <= LARGEST_PART:
            kinds.setdefault(aval.dtype, []).append((name, aval))
    groups = []
    for named in kinds.values():
        if len(named) > 1:  # one alone would gain nothing, and be reshaped
            begins = np.cumsum([0, *(aval.size for _, aval in named)])
            groups.append([(name, int(at), aval.shape) for (name, aval), at in zip(named, begins, strict=False)])
    return groups


def _joined(arrays: Sequence) -> Any:
    return jnp.concatenate([jnp.reshape(array, -1) for array in arrays])


def _read(atom: Any, known: dict) -> Any:
    if isinstance(atom, jex.Literal):
        return atom.val
    return _whole(known[atom])


def _as_function(equations: Sequence, inputs: Sequence, outputs: Sequence) -> Callable[..., list]:
    program: Any = _nothing().replace(invars=inputs, outvars=outputs, eqns=equations)
    return jex.jaxpr_as_fun(jex.ClosedJaxpr(program, ()))


@cache
def _nothing() -> Any:
    """A program to begin with: one that is made from scratch would have to know the names of its arguments."""
    return jax.make_jaxpr(lambda: ())().jaxpr


def _make(equations: list, whole: set, later: set, known: dict, is_loop: bool) -> None:
    """Evaluate operations that stand together.

    Args:
        equations: the operations.
        whole: what is read by itself.
        later: what is read by kernels to come.
        known: what has been evaluated.
        is_loop: whether this is the body of a loop.
    """
    # In an order that is the same in all processes, for JAX finds kept programs by their text.
    outs = (out for equation in equations for out in equation.outvars if not private.is_dropped(out))
    made = dict.fromkeys(outs)
    outputs = [out for out in made if out in whole or out in later]
    read = (a for equation in equations for a in equation.invars if isinstance(a, jex.Var) and a not in made)
    inputs = [*dict.fromkeys(read)]
    function = _as_function(equations, inputs, outputs)
    read_at_all: list[Any] = [a.aval for a in inputs]
    if not is_loop or len(equations) < SMALLEST_KERNEL or not any(aval.size for aval in read_at_all):
        known.update(zip(outputs, function(*(_read(a, known) for a in inputs)), strict=True))
        return
    # What is empty has no place in memory, and is made anew.
    arguments = [known[a] if aval.size else aval for a, aval in zip(inputs, read_at_all, strict=True)]
    passed = (x.vector if isinstance(x, _VectorPart) else x for x in arguments if not isinstance(x, ShapedArray))
    # Parts of one vector are passed as that vector, once. Tracers are compared by identity: `==` would be an operation.
    sources = [*{id(array): array for array in passed}.values()]
    place = {id(array): at for at, array in enumerate(sources)}
    groups = _parts([(at, out.aval) for at, out in enumerate(outputs) if out not in whole])
    apart = [at for at in range(len(outputs)) if not any(at == name for group in groups for name, *_ in group)]

    def with_vectors(*values: Any) -> list:
        def array(x: Any) -> Any:
            if isinstance(x, ShapedArray):
                return jnp.zeros(x.shape, x.dtype)
            return x.taken(values[place[id(x.vector)]]) if isinstance(x, _VectorPart) else values[place[id(x)]]

        results = function(*map(array, arguments))
        return [*(results[at] for at in apart), *(_joined([results[name] for name, *_ in group]) for group in groups)]

    shapes = [outputs[at].aval for at in apart]
    avals = [ShapedArray(shape.shape, shape.dtype) for shape in shapes]
    for group in groups:
        _, begin, shape = group[-1]
        avals.append(ShapedArray((begin + math.prod(shape),), outputs[group[0][0]].aval.dtype))
    results = _kernel.bind(*sources, function=with_vectors, avals=tuple(avals))
    known.update((outputs[at], x) for at, x in zip(apart, results, strict=False))
    for vector, group in zip(results[len(apart) :], groups, strict=True):
        known.update((outputs[at], _VectorPart(vector, begin, shape)) for at, begin, shape in group)


def _call(equation: Any, known: dict, is_loop: bool) -> None:
    """Evaluate an operation that stands alone: machine code is called in it, or it is none for a kernel."""
    name, parameters = equation.primitive.name, equation.params
    if not _calls(equation):
        _make([equation], set(equation.outvars), set(), known, is_loop=False)
        return
    values = [a.val if isinstance(a, jex.Literal) else known[a] for a in equation.invars]
    # One whose lanes end one by one is left as it is.
    if name == "while" and parameters["cond_jaxpr"].jaxpr.outvars[0].aval.size == 1:
        # A loop within a loop is part of the outer one, which was tried as a whole before.
        results = _as_a_whole(equation, [*map(_whole, values)]) if not is_loop and _is_alone(equation) else None
        known.update(zip(equation.outvars, results or _while(parameters, values), strict=True))
        return
    values = [*map(_whole, values)]
    if (inner := inner_program(name, parameters)) is not None:
        results = _evaluated(*inner, values, is_loop)
    elif name == "scan":
        loop = jax.make_jaxpr(lambda *arguments: _as_loop(parameters, arguments))(*values)
        results = _evaluated(loop.jaxpr, loop.consts, values, is_loop)
    else:
        changed = {"branches": _changed(parameters["branches"])} if name == "cond" and is_loop else {}
        inputs = [*dict.fromkeys(a for a in equation.invars if isinstance(a, jex.Var))]
        outputs = [out for out in equation.outvars if not private.is_dropped(out)]
        whole = equation.replace(params={**parameters, **changed})
        results = _as_function([whole], inputs, outputs)(*(_read(a, known) for a in inputs))
        known.update(zip(outputs, results, strict=True))
        return
    known.update(zip(equation.outvars, results, strict=True))


def _as_a_whole(equation: Any, values: Sequence) -> list | None:
    """A loop in machine code; None where something in it has no rule there."""
    try:
        return looped(equation.params, values)
    except NotWrittenError as reason:
        logging.getLogger(__name__).info("a loop of a run is left to XLA: %s", reason)
        return None


def _while(parameters: Any, values: Sequence) -> list:
    """A loop that carries its small arrays in vectors, and does the rest of each turn in few kernels.

    What it begins with, and what it returns, may be parts of vectors: a loop within a loop begins with those of the
    outer one as they are.
    """
    n_conditions, n_fixed = parameters["cond_nconsts"], parameters["body_nconsts"]
    of_condition, fixed, start = np.split(np.arange(len(values)), [n_conditions, n_conditions + n_fixed])
    condition, body = (jex.jaxpr_as_fun(parameters[name]) for name in ("cond_jaxpr", "body_jaxpr"))
    # XLA must not know a number that enters: it would write it into the kernels, and leave an argument unread.
    values = [x if isinstance(x, _VectorPart) else jax.lax.optimization_barrier(jnp.asarray(x)) for x in values]
    condition_operands, kept = ([_whole(values[i]) for i in places] for places in (of_condition, fixed))
    begin = [values[i] for i in start]
    avals = [out.aval for out in parameters["body_jaxpr"].jaxpr.outvars]
    groups = _parts([*enumerate(avals)])
    apart = [at for at in range(len(avals)) if not any(at == name for group in groups for name, *_ in group)]

    def packed(arrays: Sequence) -> list:
        return [*(_whole(arrays[at]) for at in apart), *(_vector_of([arrays[at] for at, *_ in g], g) for g in groups)]

    def parts(state: Sequence) -> list:
        carried: list[Any] = [None] * len(avals)
        for at, x in zip(apart, state, strict=False):
            carried[at] = x
        for vector, group in zip(state[len(apart) :], groups, strict=True):
            for name, at, shape in group:
                carried[name] = _VectorPart(vector, at, shape)
        return carried

    def arrays(state: Sequence) -> list:
        return [*map(_whole, parts(state))]

    # With weak types: a loop must carry what it began with, and a weak float is another type to JAX.
    examples = [jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=a.weak_type) for a in avals]
    whole = jax.make_jaxpr(lambda *all_of_it: packed(body(*all_of_it)))(*kept, *examples)

    # The same for constants of the body.
    constants = jax.lax.optimization_barrier([jnp.asarray(value) for value in whole.consts])

    def goes_on(state: list) -> Any:
        return jnp.reshape(condition(*condition_operands, *arrays(state))[0], ())  # of one lane

    def turn(state: list) -> list:
        return _evaluated(whole.jaxpr, constants, [*kept, *parts(state)], is_loop=True)

    typed = (
        x if isinstance(x, _VectorPart) else jnp.asarray(x, aval.dtype) for x, aval in zip(begin, avals, strict=True)
    )
    return parts(jax.lax.while_loop(goes_on, turn, packed([*typed])))


def _whole(value: Any) -> Any:
    """An array, also where it is a part of a vector."""
    return value.taken(value.vector) if isinstance(value, _VectorPart) else value


def _vector_of(arrays: Sequence, group: Sequence[tuple[Any, int, tuple[int, ...]]]) -> Any:
    """The arrays of a group as one vector: that which they are parts of, if they are all of it."""
    parts = [array for array in arrays if isinstance(array, _VectorPart)]
    if len(parts) == len(arrays):
        (vector, *others), (_, last, shape) = {id(part.vector): part.vector for part in parts}.values(), group[-1]
        begins = [part.begin for part in parts]
        # Then the vector is passed on as it is, and XLA copies nothing.
        if not others and begins == [begin for _, begin, _ in group] and vector.size == last + math.prod(shape):
            return vector
    return _joined([*map(_whole, arrays)])


def _as_loop(parameters: Any, arguments: Sequence) -> list:
    """A scan, whose slices and counter are then operations of its turns like all others."""
    (n_fixed, n_carried), n = private.counts_of_scan(parameters), parameters["length"]
    fixed, xs = arguments[:n_fixed], arguments[n_fixed + n_carried :]
    turn = jex.jaxpr_as_fun(parameters["jaxpr"])

    def body(state: tuple) -> tuple:
        i, carried, rows = state
        at = n - 1 - i if parameters["reverse"] else i
        results = turn(*fixed, *carried, *(jax.lax.dynamic_index_in_dim(x, at, keepdims=False) for x in xs))
        new = zip(rows, results[n_carried:], strict=True)
        return i + 1, results[:n_carried], [jax.lax.dynamic_update_index_in_dim(y, row, at, 0) for y, row in new]

    shapes = [out.aval for out in parameters["jaxpr"].jaxpr.outvars[n_carried:]]
    rows = [jnp.zeros((n, *aval.shape), aval.dtype) for aval in shapes]
    begin = jnp.zeros((), jnp.int64), list(arguments[n_fixed : n_fixed + n_carried]), rows
    _, carried, rows = jax.lax.while_loop(lambda state: state[0] < n, body, begin)
    return [*carried, *rows]


def _changed(inner: Any) -> Any:
    """Inner programs of an operation, each gone through."""
    if isinstance(inner, tuple):
        return tuple(map(_changed, inner))
    if not any(map(_calls, inner.jaxpr.eqns)):
        return inner
    examples = [
        jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype, weak_type=v.aval.weak_type) for v in inner.jaxpr.invars
    ]
    types = [(out.aval.dtype, out.aval.weak_type) for out in inner.jaxpr.outvars]

    def evaluated(*arguments: Any) -> list:
        results = _evaluated(inner.jaxpr, inner.consts, arguments, is_loop=True)
        return [x if weak else jnp.asarray(x, dtype) for x, (dtype, weak) in zip(results, types, strict=True)]

    return jax.make_jaxpr(evaluated)(*examples)


# A kernel -------------------------------------------------------------------------------------------------------------

_kernel = jex.Primitive("loop_fusion")
_kernel.multiple_results = True


@_kernel.def_impl
def _now(*values: Any, function: Callable, avals: tuple) -> list:
    del avals
    return function(*values)


@_kernel.def_abstract_eval
def _shapes(*values: Any, function: Callable, avals: tuple) -> list:
    del values, function
    return list(avals)


def _batched(values: Sequence, dims: Sequence, *, function: Callable, avals: tuple) -> tuple[Sequence, Sequence]:
    """Of many lanes it is what it was."""
    del avals
    results = jax.vmap(lambda *arrays: tuple(function(*arrays)), tuple(dims))(*values)
    return results, [0] * len(results)


def _witnesses(values: Sequence) -> list:
    """A number of each array, put together by type."""
    # By type, because numbers of several types cannot be one vector.
    filled = [value for value in values if jnp.size(value)]
    kinds = dict.fromkeys(value.dtype for value in filled)
    firsts = {kind: [jax.lax.slice(v.reshape(-1), (0,), (1,)) for v in filled if v.dtype == kind] for kind in kinds}
    return [jnp.concatenate(numbers) for numbers in firsts.values()]


def _lowered(context: Any, *values: Any, function: Callable, avals: tuple) -> Sequence:
    def whole(*arguments: Any) -> list:
        return [*function(*arguments), *_witnesses(arguments)]

    # More than one device, and not by `jax.shard_map`, where each device has a program of its own.
    if private.n_devices(context) > 1:
        # A native function cannot hold the collective operations that XLA's partitioner would put into it.
        return mlir.lower_fun(function, multiple_results=True)(context, *values)
    several_results.mark(context)
    results = mlir.lower_fun(jax.jit(whole), multiple_results=True)(context, *values)
    (first, *_) = results
    call = first.owner
    if call.name == "func.call":  # anything else is right as well, and slower
        call.attributes[private.ATTRIBUTES] = ir.DictAttr.get(
            {name: ir.StringAttr.get(word) for name, word in private.KERNEL_ATTRIBUTES.items()}
        )
    return results[: len(avals)]


batching.primitive_batchers[_kernel] = _batched
mlir.register_lowering(_kernel, _lowered, platform="cpu")
mlir.register_lowering(
    _kernel, mlir.lower_fun(lambda *values, function, avals: function(*values), multiple_results=True)
)
