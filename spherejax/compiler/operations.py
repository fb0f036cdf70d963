"""What an operation on numbers is: one record for each, which every part of the compiler reads.

A record says how constants fold, how NumPy and Python evaluate it, how it is differentiated and transposed, and how it
is written in StableHLO, in LLVM's language and in C. To admit a primitive of JAX is one entry of `OPERATIONS`, and one
row in `tests/compiler/test_operations.py`, which holds all of these against JAX. What a record leaves out falls back:

| left out | then |
|---|---|
| `fold`, `expand` | one node for each entry; a constant where all arguments are constants |
| `numpy` | JAX evaluates constants, which compiles a program for each operation |
| `python` | NumPy evaluates |
| `derivative`, `partials` | JAX's own rule is traced |
| `transpose` | the operation is not linear: transposing it is refused |
| `stablehlo` | JAX's own lowering |
| `llvm` | XLA compiles the program around it |
| `c` | C source is refused, by the operation's name |

Operations on whole arrays have a second kind of record, in `array_operations`: in a scalar program they are no
operations at all, but names that change places, or several operations of this file.

This file stands below the graph: rules get the graph, or the writer of a text, as an argument.
"""

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, NamedTuple, Protocol

import numpy as np
from jax import dtypes, lax
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import stablehlo

FLOAT, BOOL, INT = np.dtype("float64"), np.dtype("bool"), np.dtype("int64")
"""Types of numbers that a program has."""

DOUBLE, WHOLE, TRUTH = "double", "i64", "i1"
"""The same in LLVM's language."""

# Whole numbers are of 64 bits whatever JAX has them in: they count and choose, and nothing relies on their overflow.
KINDS = {FLOAT: DOUBLE, INT: WHOLE, BOOL: TRUTH}


class NotScalarizable(Exception):  # noqa: N818 - it says what it is
    """The function has no scalar program; the message says which operation stands in the way.

    Attributes:
        is_too_large: whether its size alone stands in the way.
    """

    is_too_large = False


def graph_dtype(dtype: Any) -> np.dtype:
    """The type of a node for an array's entries."""
    try:
        kind = np.dtype(dtype).kind
    except TypeError:  # a dtype of JAX's own, such as that of random keys
        raise NotScalarizable(f"values of type {dtype}") from None
    if dtype == FLOAT:
        return FLOAT
    if kind == "b" or dtype == dtypes.float0:  # the second is the tangent of an index, which nothing reads
        return BOOL
    if kind in "iu" and dtype != np.uint64:  # which has numbers beyond those of 64 bits with a sign
        return INT
    raise NotScalarizable(f"numbers of type {dtype}")


class Call(NamedTuple):
    """One use of an operation, as far as its text depends on it.

    Attributes:
        kinds: of its arguments, as LLVM calls them.
        kind: of its result.
        parameters: those of the primitive.
    """

    kinds: tuple[str, ...]
    kind: str
    parameters: Mapping[str, Any]


class LlvmWriter(Protocol):
    """What rules write LLVM's language with: single numbers or vectors, of lanes or of entries of an array."""

    def made(self, text: str, /) -> str:
        """The name of what an instruction gives."""
        ...

    def type(self, kind: str) -> str:
        """The type of numbers of a kind."""
        ...

    def number(self, value: Any, kind: str) -> str:
        """A constant."""
        ...

    def intrinsic(self, word: str, kind: str, *names: str, result: str | None = None) -> str:
        """A function that LLVM has itself; `result` where it gives another kind than it takes."""
        ...

    def library(self, word: str, *names: str) -> str:
        """A function of the mathematical library."""
        ...


def same(*kinds: str) -> Callable[[Call], bool]:
    """Accepts arguments that are all of one kind, among these."""
    return lambda call: len(set(call.kinds)) == 1 and call.kinds[0] in kinds


_OF_FLOATS = same(DOUBLE)


@dataclass(frozen=True, kw_only=True)
class ScalarOperation:
    """What an operation on numbers is.

    Attributes:
        name: of nodes of a graph.
        jax: evaluates it, from arrays or tracers and the primitive's parameters; None where no node has its name,
            for it is always folded into others.
        primitives: names of the primitives of JAX that are this operation; None is its own name.
        fold: from a graph, nodes and the primitive's parameters to a node, where constants simplify it.
        expand: the operation as several others; like `fold`, but with whoever has `add`, `sub`, `mul`, `div` and
            `constant`: a graph, or a writer of arrays.
        commutes: whether a op b is b op a, to the last bit: then both orders are one node.
        copies: whether the result is the argument, unless its type changes.
        numpy: evaluates arrays; exactly what JAX gives but for rounding, also for NaN and infinities.
        python: evaluates Python's floats and truths; some 30 ns, where a NumPy scalar takes a microsecond.
        takes_whole: whether `python` evaluates whole numbers, too: it chooses among numbers, and computes none.
        derivative: from a `Forward`, a node, its arguments and their tangents to its tangent.
        partials: the derivative by each argument, as functions of JAX.
        transpose: from a graph, the number along a node, its arguments, and which of them move, to the numbers along
            the arguments; None from it where the operation is not linear in these.
        stablehlo: from values of StableHLO to one.
        llvm: from a `LlvmWriter`, a `Call` and names to a name.
        accepts: the calls that `llvm` can write.
        library: the function of the mathematical library that `llvm` calls, where the operation is one.
        example: arguments of that function, with which a platform's library is tried.
        c: an expression, with `{}` for the arguments; or a function from a `Call` to one. The former is for
            floats and truths alone.
        c_of_whole: an expression for whole numbers.
    """

    name: str
    jax: Callable[..., Any] | None = None
    primitives: tuple[str, ...] | None = None
    fold: Callable[..., int] | None = None
    expand: Callable[..., Any] | None = None
    commutes: bool = False
    copies: bool = False
    numpy: Callable[..., Any] | None = None
    python: Callable[..., Any] | None = None
    takes_whole: bool = False
    derivative: Callable[..., int | None] | None = None
    partials: tuple[Callable[..., Any], ...] | None = None
    transpose: Callable[..., list[int] | None] | None = None
    stablehlo: Callable[..., Any] | None = None
    llvm: Callable[..., str] | None = None
    accepts: Callable[[Call], bool] = _OF_FLOATS
    library: str | None = None
    example: tuple[float, ...] = (0.5,)
    c: str | Callable[[Call], str] | None = None
    c_of_whole: str | None = None

    @property
    def folded(self) -> Callable[..., int] | None:
        """From a graph, nodes and parameters to a node; None where each use is a node of its own."""
        return self.fold or self.expand

    def can_be_llvm(self, call: Call) -> bool:
        """Whether there is LLVM text for a use of it."""
        return (self.llvm is not None or self.expand is not None) and self.accepts(call)

    def in_llvm(self, text: "LlvmWriter", call: Call, *names: str) -> str:
        """The text of a use of it that can be written; the name of the result."""
        if self.llvm is not None:
            return self.llvm(text, call, *names)
        assert self.expand is not None, self.name
        return self.expand(_ExpandedInLlvm(text, call.kind), *names, **call.parameters)

    def in_c(self, call: Call, *names: str) -> str | None:
        """The expression in C; None where there is none."""
        template = self.c(call) if callable(self.c) else self.c_of_whole if WHOLE in call.kinds else self.c
        return None if template is None else template.format(*names)


# Arithmetic: what folds -----------------------------------------------------------------------------------------------
#
# Structural zeros are what makes scalar programs small: most entries of mass matrices, Jacobians and rotations are 0 or
# 1. A zero times x is therefore 0 whatever x is, as it would be in a matrix that stores no zeros; the program presumes
# finite numbers there. Negations are moved outwards, or into a difference, where they cost nothing.


def _fold_add(graph, a, b, **_):
    if graph.is_value(a, 0):
        return b
    if graph.is_value(b, 0):
        return a
    if graph.operations[b] == "neg":
        return graph.sub(a, graph.arguments[b][0])
    if graph.operations[a] == "neg":
        return graph.sub(b, graph.arguments[a][0])
    return graph.apply("add", (a, b))


def _fold_sub(graph, a, b, **_):
    if graph.is_value(b, 0):
        return a
    if graph.is_value(a, 0):
        return graph.neg(b)
    # x - x is a structural zero, as 0 x is.
    if a == b and not graph.is_constant(a) and graph.dtypes[a] == FLOAT:
        return graph.constant(0, graph.dtypes[a])
    if graph.operations[b] == "neg":
        return graph.add(a, graph.arguments[b][0])
    return graph.apply("sub", (a, b))


def _fold_mul(graph, a, b, **_):
    for x, y in ((a, b), (b, a)):
        if graph.is_constant(x):
            value = graph.value(x)
            if value == 0:
                return graph.constant(0, graph.dtypes[x])
            if value == 1:
                return y
            if value == -1:
                return graph.neg(y)
    if graph.operations[a] == "neg" and graph.operations[b] == "neg":
        return graph.mul(graph.arguments[a][0], graph.arguments[b][0])
    if graph.operations[a] == "neg":
        return graph.neg(graph.mul(graph.arguments[a][0], b))
    if graph.operations[b] == "neg":
        return graph.neg(graph.mul(a, graph.arguments[b][0]))
    return graph.apply("mul", (a, b))


def _fold_div(graph, a, b, **_):
    if graph.is_value(b, 1):
        return a
    if graph.is_value(a, 0) and not graph.is_constant(b):
        return a  # 0 / 0 of constants is NaN, which must be seen
    return graph.apply("div", (a, b))


def _fold_neg(graph, a, **_):
    if graph.operations[a] == "neg":
        return graph.arguments[a][0]
    if graph.operations[a] == "sub":  # -(x - y) is y - x to the last bit
        x, y = graph.arguments[a]
        return graph.sub(y, x)
    return graph.apply("neg", (a,))


def _fold_select(graph, predicate, *cases, **_):
    if graph.dtypes[predicate] != BOOL:
        return graph.lookup(predicate, cases)
    on_false, on_true = cases
    if graph.is_constant(predicate):
        return on_true if graph.value(predicate) else on_false
    if on_false == on_true:
        return on_true
    return graph.node("select", (predicate, on_false, on_true), graph.dtypes[on_true])


def _fold_logic(name, decides):
    """`and` or `or`, with the truth that decides alone."""

    def fold(graph, a, b, **_):
        for x, y in ((a, b), (b, a)):
            if graph.dtypes[x] == BOOL and graph.is_constant(x):
                return x if graph.value(x) == decides else y
        return graph.apply(name, (a, b))

    return fold


# JAX orders numbers for searches and sorts by their bits, in which -0 is before 0 and NaN is behind or before all else,
# by its sign. It makes zeros and NaN of either sign one before. Of such numbers the order is that of comparisons.


def _ordered(graph, node):
    """The number that JAX has made one to be ordered by its bits from."""
    if graph.dtypes[node] != FLOAT or graph.is_constant(node):
        return node
    if graph.operations[node] == "select":
        is_nan, number, nan = graph.arguments[node]
        if graph.is_constant(nan) and np.isnan(graph.value(nan)) and graph.operations[number] == "select":
            is_zero, number, zero = graph.arguments[number]
            zero_of, nan_of = graph.apply("eq", (number, zero), BOOL), graph.apply("ne", (number, number), BOOL)
            if graph.is_value(zero, 0) and (is_zero, is_nan) == (zero_of, nan_of):
                return number
    raise NotScalarizable("an order of numbers by their bits")


def _fold_before(graph, a, b, **_):
    """Whether a stands before b; NaN is behind all else."""
    a, b = _ordered(graph, a), _ordered(graph, b)
    if graph.dtypes[a] != FLOAT:
        return graph.apply("lt", (a, b), BOOL)
    is_number = graph.apply("eq", (a, a), BOOL)
    is_behind = graph.apply("le", (b, a), BOOL)  # false where either is NaN
    return graph.both(graph.apply("not", (is_behind,)), is_number)


def _fold_not_behind(graph, a, b, **_):
    a, b = _ordered(graph, a), _ordered(graph, b)
    is_not_behind = graph.apply("le", (a, b), BOOL)
    return is_not_behind if graph.dtypes[a] != FLOAT else graph.either(is_not_behind, graph.apply("ne", (b, b), BOOL))


def _fold_power(graph, a, b, **_):
    """For a >= 0; exponents that are small multiples of one half become products and a square root.

    Of a right-hand side with Hertz's contact (exponent 3/2), `pow` would take a tenth of the time.
    """
    if graph.is_constant(b) and not graph.is_constant(a):
        exponent = float(graph.value(b))
        if abs(exponent) <= 4 and 2 * exponent == math.floor(2 * exponent):
            if exponent < 0:  # of the whole power: a^-1 sqrt(a) would be NaN at 0 and at infinity
                return graph.div(graph.constant(1, FLOAT), graph.power(a, graph.constant(-exponent, FLOAT)))
            whole = graph.integer_power(a, math.floor(exponent))
            if exponent == math.floor(exponent):
                return whole
            # a sqrt(a) has the derivative 0 at 0, but its factors have 0 and infinity.
            root = "root_guarded_at_zero" if exponent > 1 / 2 else "sqrt"
            return graph.mul(whole, graph.node(root, (a,), FLOAT))
    return graph.apply("pow", (a, b))


def _fold_sqrt(graph, a, **_):
    # By the power, so that x^(1/2) and the root of x are one node.
    return graph.power(a, graph.constant(0.5, FLOAT))


def _fold_convert(graph, a, *, new_dtype, **_):
    source, target = graph.dtypes[a], graph_dtype(new_dtype)
    if source == target:
        return a
    if (source, target) == (FLOAT, INT):
        # Of a type of fewer bits what is beyond its range is taken to its bounds; it does not wrap around.
        whole, bounds = graph.apply("integer_of_float", (a,), INT), np.iinfo(new_dtype)
        return graph.bounded(whole, int(bounds.min), int(bounds.max))
    if graph.is_constant(a):
        return graph.constant(graph.value(a), target)
    if source == BOOL:  # a selection has a rule in every form, and `cond` finds the truth again behind it
        return graph.select(a, graph.constant(0, target), graph.constant(1, target))
    if target == BOOL:
        return graph.apply("ne", (a, graph.constant(0, source)), BOOL)
    return graph.apply("float_of_integer", (a,), FLOAT)


def _fold_log2(graph, a, **parameters):
    logarithm = graph.apply("log", (a,), parameters=tuple(sorted(parameters.items())))
    return graph.mul(logarithm, graph.constant(1 / np.log(2), FLOAT))


# Operations that are several others -----------------------------------------------------------------------------------


def _expand_square(build, a, **_):
    return build.mul(a, a)


def _expand_integer_power(build, a, *, y, **_):
    """By squaring; the factors from the lowest power on."""
    power, square, left = None, a, abs(y)
    while left:
        if left & 1:
            power = square if power is None else build.mul(power, square)
        left >>= 1
        square = build.mul(square, square) if left else square
    power = build.constant(1, FLOAT) if power is None else power
    return build.div(build.constant(1, FLOAT), power) if y < 0 else power


def _expand_one_minus_square(build, a, **_):
    one = build.constant(1, FLOAT)
    return build.mul(build.add(one, a), build.sub(one, a))  # 1 - a^2 would lose digits near 1


def _expand_polynomial(build, x, *coefficients, **_):
    """By Horner's rule; the coefficients from the lowest degree on."""
    return reduce(lambda total, a: build.add(a, build.mul(x, total)), reversed(coefficients))


# Derivatives: what the value has computed serves for them -------------------------------------------------------------
#
# `forward` is an `autodiff.Forward`. A tangent is None where an argument does not move.


def _derive_add(forward, node, arguments, tangents):
    return forward.sum(*tangents)


def _derive_sub(forward, node, arguments, tangents):
    left, right = tangents
    if right is None:
        return left
    return forward.slopes.neg(right) if left is None else forward.slopes.sub(left, right)


def _derive_neg(forward, node, arguments, tangents):
    return forward.slopes.neg(tangents[0])


def _derive_mul(forward, node, arguments, tangents):
    (a, b), (da, db) = arguments, tangents
    if a == b:  # 2 a da: one product and not two
        return forward.times(forward.values.add(a, a), da)
    return forward.sum(forward.times(b, da), forward.times(a, db))


def _derive_div(forward, node, arguments, tangents):
    """(a / b)' = (a' - (a / b) b') / b, which needs one reciprocal for all tangents."""
    b, (da, db) = arguments[1], tangents
    change = None if db is None else forward.times(node, db)
    if change is not None:
        da = forward.slopes.neg(change) if da is None else forward.slopes.sub(da, change)
    return forward.times(forward.values.div(forward.values.constant(1, FLOAT), b), da)


def _derive_sqrt(forward, node, arguments, tangents):
    # 1 / (2 sqrt(a)), from the root that the value has.
    return forward.times(forward.values.div(forward.values.constant(0.5, FLOAT), node), tangents[0])


def _derive_select(forward, node, arguments, tangents):
    zero = forward.slopes.constant(0, FLOAT)
    on_false, on_true = (zero if tangent is None else tangent for tangent in tangents[1:])
    if on_false == on_true == zero:
        return None
    # The derivative of the branch that is taken alone: a product with 0 and 1 would let NaN of the other one through.
    return forward.slopes.select(forward.coefficient(arguments[0]), on_false, on_true)


def _derive_lookup(forward, node, arguments, tangents):
    index, slopes = arguments[0], tangents[1:]
    moving = [place for place, slope in enumerate(slopes) if slope is not None]
    if not moving:
        return None
    zero = forward.slopes.constant(0, FLOAT)
    if len(moving) > FEW_MOVING:
        cases = [zero if slope is None else slope for slope in slopes]
        return forward.slopes.node("lookup", (forward.coefficient(index), *cases), FLOAT)
    # Along a few entries of a table: most of it would be zeros.
    return forward.sum(*(
        forward.slopes.select(forward.coefficient(_is_at(forward.values, index, place)), zero, slopes[place])
        for place in moving
    ))  # fmt: skip


def _is_at(graph, index, place):
    return graph.apply("eq", (index, graph.constant(place, INT)), BOOL)


FEW_MOVING = 3
"""Entries of a table that move, up to which its derivative is by a comparison for each."""


# Transposes: from the number along a result to those along its arguments ----------------------------------------------


def _transpose_mul(graph, along, arguments, moves):
    # Of what moves squared there is no transpose: it is not linear.
    return None if all(moves) else [graph.mul(along, arguments[1]), graph.mul(along, arguments[0])]


def _transpose_div(graph, along, arguments, moves):
    return None if moves[1] else [graph.div(along, arguments[1]), along]


def _transpose_select(graph, along, arguments, moves):
    if moves[0]:
        return None
    zero = graph.constant(0, FLOAT)
    return [along, graph.select(arguments[0], along, zero), graph.select(arguments[0], zero, along)]


def _transpose_lookup(graph, along, arguments, moves):
    if moves[0]:
        return None
    zero = graph.constant(0, FLOAT)
    return [
        graph.select(_is_at(graph, arguments[0], at - 1), zero, along) if moves[at] else zero
        for at in range(len(arguments))
    ]


# NumPy and Python, where their own functions are not JAX's ------------------------------------------------------------


def _divide(a, b):
    """`jax.lax.div`: integers are cut towards zero, and -1 where the divisor is 0."""
    if np.asarray(a).dtype.kind == "f":
        return np.divide(a, b)
    divisor = np.where((b == 0) | (b == -1), 1, b)
    floor, rest = np.divmod(a, divisor)
    quotient = floor + ((rest != 0) & ((a < 0) != (divisor < 0)))
    # By -1 the least number has no quotient: it is itself.
    return np.where(b == 0, -1, np.where(b == -1, np.negative(a), quotient))


def _quotient(a: float, b: float) -> float:
    return a / b if b else float(np.divide(a, b))  # Python raises an error


def _remainder(a, b):
    """`jax.lax.rem`: of the sign of a; of whole numbers a itself where the divisor is 0."""
    if np.asarray(a).dtype.kind == "f":
        return np.fmod(a, b)
    return np.where(b == 0, a, np.fmod(a, np.where(b == 0, 1, b)))


def _integer_of_float(a):
    """Cut towards zero; NaN is 0, and what is beyond 64 bits is the nearer bound, as in XLA."""
    beyond = 2.0**63
    inside = np.where(np.abs(a) < beyond, a, 0.0).astype(np.int64)
    return np.where(a >= beyond, np.iinfo(np.int64).max, np.where(a <= -beyond, np.iinfo(np.int64).min, inside))


def _root(a: float) -> float:
    return math.sqrt(a) if a >= 0 else math.nan  # Python raises an error of negative numbers; NaN is not >= 0


def _sine(a: float) -> float:
    return math.sin(a) if math.isfinite(a) else math.nan  # Python raises an error of infinity


def _cosine(a: float) -> float:
    return math.cos(a) if math.isfinite(a) else math.nan


WRITTEN_OUT = 16
"""Cases of a lookup that XLA has as selections, at most; more are an array that is read at a place."""


def _lookup(index, *cases):
    if len(cases) <= WRITTEN_OUT:
        return lax.select_n(lax.convert_element_type(index, np.int32), *cases)
    return entry_of(index, lax.concatenate([lax.expand_dims(case, [0]) for case in cases], 0))


def entry_of(index, table):
    """The entry of a table, which all lanes of the index share, or of which each has its own, at a place inside."""
    if not index.shape:
        return lax.dynamic_index_in_dim(table, index, keepdims=False)
    own = [lax.broadcasted_iota(np.int64, index.shape, axis) for axis in range(table.ndim - 1)]
    return table.at[(index, *own)].get(mode="promise_in_bounds")


def _root_guarded_at_zero(a):
    # The root of 1 stands for that of 0, whose derivative is infinite: times 0 it would be NaN in reverse mode.
    is_zero = lax.eq(a, lax.full_like(a, 0.0))
    root = lax.sqrt(lax.select_n(is_zero, a, lax.full_like(a, 1.0)))
    return lax.select_n(is_zero, root, lax.full_like(a, 0.0))


# StableHLO ------------------------------------------------------------------------------------------------------------


def _compared_in_stablehlo(direction: str) -> Callable[..., Any]:
    def write(a, b):
        # JAX's types: truths are compared as unsigned, whole numbers as signed.
        element = str(ir.RankedTensorType(a.type).element_type)
        kind = {"f64": "FLOAT", "i1": "UNSIGNED"}.get(element, "SIGNED")
        how = stablehlo.ComparisonTypeAttr.get(kind)
        return stablehlo.compare(a, b, stablehlo.ComparisonDirectionAttr.get(direction), compare_type=how)

    return write


# LLVM -----------------------------------------------------------------------------------------------------------------


def _arithmetic(word: str) -> Callable[..., str]:
    """A sum, a difference or a product; as XLA does, a product and a sum may become one operation (`contract`)."""

    def write(text: LlvmWriter, call: Call, a: str, b: str) -> str:
        (kind, _) = call.kinds
        return text.made(f"{f'f{word} contract' if kind == DOUBLE else word} {text.type(kind)} {a}, {b}")

    return write


def _llvm_div(text, call, a, b):
    if call.kinds[0] == DOUBLE:
        return text.made(f"fdiv {text.type(DOUBLE)} {a}, {b}")
    truth, typed = text.type(TRUTH), text.type(WHOLE)
    quotient = text.made(f"sdiv {typed} {a}, {_safe_divisor(text, b)}")
    # -1 where the divisor is 0; by -1 the least number would be beyond the largest, and is itself.
    by_minus_one = text.made(f"icmp eq {typed} {b}, {text.number(-1, WHOLE)}")
    negative = text.made(f"sub {typed} {text.number(0, WHOLE)}, {a}")
    quotient = text.made(f"select {truth} {by_minus_one}, {typed} {negative}, {typed} {quotient}")
    by_zero = text.made(f"icmp eq {typed} {b}, {text.number(0, WHOLE)}")
    return text.made(f"select {truth} {by_zero}, {typed} {text.number(-1, WHOLE)}, {typed} {quotient}")


def _safe_divisor(text, b):
    """A divisor, or 1 where LLVM leaves the quotient undefined: of 0, and of -1, by which the least number has none."""
    truth, typed = text.type(TRUTH), text.type(WHOLE)
    shifted = text.made(f"add {typed} {b}, {text.number(1, WHOLE)}")
    is_special = text.made(f"icmp ult {typed} {shifted}, {text.number(2, WHOLE)}")
    return text.made(f"select {truth} {is_special}, {typed} {text.number(1, WHOLE)}, {typed} {b}")


def _llvm_rem(text, call, a, b):
    if call.kinds[0] == DOUBLE:
        return text.library("fmod", a, b)
    truth, typed = text.type(TRUTH), text.type(WHOLE)
    remainder = text.made(f"srem {typed} {a}, {_safe_divisor(text, b)}")
    by_zero = text.made(f"icmp eq {typed} {b}, {text.number(0, WHOLE)}")
    return text.made(f"select {truth} {by_zero}, {typed} {a}, {typed} {remainder}")


def _ordered_bits(text, a):
    """A whole number by which floats are in the order of their bits: those below zero are turned round."""
    typed = text.type(WHOLE)
    bits = text.made(f"bitcast {text.type(DOUBLE)} {a} to {typed}")
    sign = text.made(f"ashr {typed} {bits}, {text.number(63, WHOLE)}")
    return text.made(f"xor {typed} {bits}, {text.made(f'lshr {typed} {sign}, {text.number(1, WHOLE)}')}")


def _before(word: str) -> Callable[..., str]:
    def write(text: LlvmWriter, call: Call, a: str, b: str) -> str:
        if call.kinds[0] == DOUBLE:
            a, b = _ordered_bits(text, a), _ordered_bits(text, b)
        return text.made(f"icmp {word} {text.type(WHOLE)} {a}, {b}")

    return write


def _llvm_neg(text, call, a):
    (kind,) = call.kinds
    typed = text.type(kind)
    # Not 0 - a, which is +0 for 0.
    return text.made(f"fneg {typed} {a}" if kind == DOUBLE else f"sub {typed} {text.number(0, kind)}, {a}")


def _extremum(word: str) -> Callable[..., str]:
    """`max` or `min`; NaN wins, as in JAX, which is LLVM's `maximum` and not its `maxnum`."""

    def write(text: LlvmWriter, call: Call, a: str, b: str) -> str:
        kind = call.kinds[0]
        if kind == TRUTH:
            return text.made(f"{'or' if word == 'max' else 'and'} {text.type(kind)} {a}, {b}")
        return text.intrinsic(f"{word}imum" if kind == DOUBLE else f"s{word}", kind, a, b)

    return write


def _llvm_clamp(text, call, low, x, high):
    # In this order: where the bounds are crossed, StableHLO gives the upper one.
    return _extremum("min")(text, call, _extremum("max")(text, call, low, x), high)


def _compared(of_floats: str, of_whole: str) -> Callable[..., str]:
    def write(text: LlvmWriter, call: Call, a: str, b: str) -> str:
        (kind, _) = call.kinds
        word = f"fcmp {of_floats}" if kind == DOUBLE else f"icmp {of_whole}"
        return text.made(f"{word} {text.type(kind)} {a}, {b}")

    return write


def _logic(word: str) -> Callable[..., str]:
    """Of truths, or of the bits of whole numbers."""
    return lambda text, call, a, b: text.made(f"{word} {text.type(call.kind)} {a}, {b}")


def _llvm_not(text, call, a):
    (kind,) = call.kinds
    return text.made(f"xor {text.type(kind)} {a}, {text.number(True if kind == TRUTH else -1, kind)}")


def _llvm_abs(text, call, a):
    (kind,) = call.kinds
    if kind == DOUBLE:
        return text.intrinsic("fabs", kind, a)
    return text.intrinsic("smax", kind, a, _llvm_neg(text, call, a))


def _llvm_sign(text, call, a):
    """Of NaN and of zeros what they are."""
    if call.kinds[0] == WHOLE:
        above = text.intrinsic("smax", WHOLE, a, text.number(-1, WHOLE))
        return text.intrinsic("smin", WHOLE, above, text.number(1, WHOLE))
    typed, truth, zero = text.type(DOUBLE), text.type(TRUTH), text.number(0, DOUBLE)
    above, below = (text.made(f"fcmp {word} {typed} {a}, {zero}") for word in ("ogt", "olt"))
    not_above = text.made(f"select {truth} {below}, {typed} {text.number(-1, DOUBLE)}, {typed} {a}")
    return text.made(f"select {truth} {above}, {typed} {text.number(1, DOUBLE)}, {typed} {not_above}")


def _llvm_rsqrt(text, call, a):
    # Processors' own approximations have 12 or 14 bits.
    root = text.intrinsic("sqrt", DOUBLE, a)
    return text.made(f"fdiv {text.type(DOUBLE)} {text.number(1, DOUBLE)}, {root}")


def _llvm_is_finite(text, call, a):
    # An ordered comparison: false of NaN, too.
    size = text.intrinsic("fabs", DOUBLE, a)
    return text.made(f"fcmp olt {text.type(DOUBLE)} {size}, {text.number(np.inf, DOUBLE)}")


def _llvm_logistic(text, call, a):
    # Far below zero exp overflows to infinity, and its reciprocal is the 0 that it should be.
    typed, one = text.type(DOUBLE), text.number(1, DOUBLE)
    falling = text.library("exp", text.made(f"fneg {typed} {a}"))
    return text.made(f"fdiv {typed} {one}, {text.made(f'fadd {typed} {one}, {falling}')}")


def _rounds_to_even(call: Call) -> bool:
    return bool(int(call.parameters["rounding_method"]))  # 0 is away from zero


def _llvm_round(text, call, a):
    return text.intrinsic("roundeven" if _rounds_to_even(call) else "round", DOUBLE, a)


def _llvm_select(text, call, which, *cases):
    typed, (kind_of_which, *_) = text.type(call.kind), call.kinds
    if kind_of_which == TRUTH:
        on_false, on_true = cases
        return text.made(f"select {text.type(TRUTH)} {which}, {typed} {on_true}, {typed} {on_false}")
    chosen = cases[-1]  # as JAX clamps the number, what is beyond the last is the last, and below the first the first
    for at in range(len(cases) - 2, -1, -1):
        is_it = text.made(f"icmp sle {text.type(WHOLE)} {which}, {text.number(at, WHOLE)}")
        chosen = text.made(f"select {text.type(TRUTH)} {is_it}, {typed} {cases[at]}, {typed} {chosen}")
    return chosen


def _llvm_convert(text, call, a):
    (source,), target = call.kinds, call.kind
    if source == target:
        return a
    typed, to = text.type(source), text.type(target)
    if target == TRUTH:
        word = "fcmp une" if source == DOUBLE else "icmp ne"
        return text.made(f"{word} {typed} {a}, {text.number(0, source)}")
    if source == DOUBLE:  # NaN is 0, and what is too large the largest, as in XLA; `fptosi` leaves both undefined
        whole, bounds = text.intrinsic("fptosi.sat", source, a, result=target), np.iinfo(call.parameters["new_dtype"])
        if bounds.bits == 64:
            return whole
        whole = text.intrinsic("smax", target, whole, text.number(bounds.min, target))
        return text.intrinsic("smin", target, whole, text.number(bounds.max, target))
    word = {(TRUTH, WHOLE): "zext", (TRUTH, DOUBLE): "uitofp", (WHOLE, DOUBLE): "sitofp"}[source, target]
    return text.made(f"{word} {typed} {a} to {to}")


def _llvm_lookup(text, call, index, *cases):
    """Selections, for a few cases; of more `FunctionText` makes a table."""
    return _llvm_select(text, call, index, *cases)


def _modulo(sign: str) -> str:
    """In C, where whole numbers with a sign must not overflow, and those without wrap around."""
    return f"(long long)((unsigned long long){{}} {sign} (unsigned long long){{}})"


def _c_lookup(call: Call) -> str:
    kind = {DOUBLE: "double", WHOLE: "long long", TRUTH: "int"}[call.kind]
    entries = ", ".join(f"{{{at}}}" for at in range(1, len(call.kinds)))
    return f"((const {kind}[]){{{{{entries}}}}})[{{0}}]"


def _llvm_power(text, call, base, exponent):
    if call.kinds[1] == WHOLE:
        exponent = _llvm_convert(text, Call((WHOLE,), DOUBLE, {}), exponent)
    return text.library("pow", base, exponent)


def _in_library(word: str) -> Callable[..., str]:
    return lambda text, call, *names: text.library(word, *names)


def _intrinsic(word: str) -> Callable[..., str]:
    return lambda text, call, *names: text.intrinsic(word, DOUBLE, *names)


class _ExpandedInLlvm:
    """What `expand` writes with, where its nodes are names in a text."""

    def __init__(self, text: LlvmWriter, kind: str):
        self._text, self._kind = text, kind
        self.add, self.sub, self.mul, self.div = (self._operation(name) for name in ("add", "sub", "mul", "div"))

    def _operation(self, name: str) -> Callable[[str, str], str]:
        call = Call((self._kind, self._kind), self._kind, {})
        return lambda a, b: OPERATIONS[name].in_llvm(self._text, call, a, b)

    def constant(self, value: Any, dtype: np.dtype) -> str:
        return self._text.number(value, KINDS[dtype])


# The records ----------------------------------------------------------------------------------------------------------


def _function(
    name: str, numpy: Callable[..., Any] | None, *, word: str | None = None, **others: Any
) -> ScalarOperation:
    """An operation that the mathematical library has, by the same name there, `word`, for LLVM and for C."""
    word, n_arguments = word or name, len(others.get("example", (0.5,)))
    return ScalarOperation(
        name=name,
        jax=getattr(lax, f"{name}_p").bind,
        numpy=numpy,
        llvm=_in_library(word),
        library=word,
        c=f"{word}({', '.join(['{}'] * n_arguments)})",
        **others,
    )


def _comparison(name: str, sign: str, numpy: Callable[..., Any], python: Callable[..., Any], of_floats: str,
                of_whole: str, kinds: tuple[str, ...] = (DOUBLE, WHOLE)) -> ScalarOperation:  # fmt: skip
    return ScalarOperation(
        name=name,
        jax=getattr(lax, f"{name}_p").bind,
        numpy=numpy,
        python=python,
        stablehlo=_compared_in_stablehlo(name.upper()),
        llvm=_compared(of_floats, of_whole),
        accepts=same(*kinds),
        c=f"{{}} {sign} {{}}",
        c_of_whole=f"{{}} {sign} {{}}",
    )


def _on_two(
    name: str,
    kinds: tuple[str, ...],
    numpy: Callable[..., Any],
    in_stablehlo: Callable[..., Any] | None,
    llvm: Callable[..., str],
    c: str,
    c_of_whole: str,
    fold: Callable[..., int] | None = None,
) -> ScalarOperation:
    """An operation on two numbers of one of these types, with a result of that type."""
    return ScalarOperation(
        name=name,
        fold=fold,
        jax=getattr(lax, f"{name}_p").bind,
        numpy=numpy,
        stablehlo=in_stablehlo,
        llvm=llvm,
        accepts=same(*kinds),
        c=c,
        c_of_whole=c_of_whole,
    )


_ORDERED, _OF_BITS = (DOUBLE, WHOLE, TRUTH), (TRUTH, WHOLE)
_OF_ERF = 2.0 / np.sqrt(np.pi)

_ALL = (
    # Arithmetic. JAX's `add_any` sums cotangents, and has no public name. Functions of `lax` and not `bind`, for these
    # take constants as NumPy has them.
    ScalarOperation(
        name="add",
        jax=lax.add,
        primitives=("add", "add_any"),
        fold=_fold_add,
        commutes=True,
        numpy=np.add,
        python=operator.add,
        derivative=_derive_add,
        transpose=lambda graph, along, arguments, moves: [along, along],
        stablehlo=stablehlo.add,
        llvm=_arithmetic("add"),
        accepts=same(DOUBLE, WHOLE),
        c="{} + {}",
        c_of_whole=_modulo("+"),
    ),
    ScalarOperation(
        name="sub",
        jax=lax.sub,
        fold=_fold_sub,
        numpy=np.subtract,
        python=operator.sub,
        derivative=_derive_sub,
        transpose=lambda graph, along, arguments, moves: [along, graph.neg(along)],
        stablehlo=stablehlo.subtract,
        llvm=_arithmetic("sub"),
        accepts=same(DOUBLE, WHOLE),
        c="{} - {}",
        c_of_whole=_modulo("-"),
    ),
    ScalarOperation(
        name="mul",
        jax=lax.mul,
        fold=_fold_mul,
        commutes=True,
        numpy=np.multiply,
        python=operator.mul,
        derivative=_derive_mul,
        transpose=_transpose_mul,
        stablehlo=stablehlo.multiply,
        llvm=_arithmetic("mul"),
        accepts=same(DOUBLE, WHOLE),
        c="{} * {}",
        c_of_whole=_modulo("*"),
    ),
    ScalarOperation(
        name="div",
        jax=lax.div,
        fold=_fold_div,
        numpy=_divide,
        python=_quotient,
        derivative=_derive_div,
        transpose=_transpose_div,
        stablehlo=stablehlo.divide,
        llvm=_llvm_div,
        accepts=same(DOUBLE, WHOLE),
        c="{} / {}",
        c_of_whole="quotient({}, {})",
    ),
    ScalarOperation(
        name="neg",
        jax=lax.neg,
        fold=_fold_neg,
        numpy=np.negative,
        python=operator.neg,
        derivative=_derive_neg,
        transpose=lambda graph, along, arguments, moves: [graph.neg(along)],
        stablehlo=stablehlo.negate,
        llvm=_llvm_neg,
        accepts=same(DOUBLE, WHOLE),
        c="-{}",
        c_of_whole="(long long)(0ULL - (unsigned long long){})",
    ),
    ScalarOperation(
        name="select",
        jax=lax.select_n,
        primitives=("select_n",),
        fold=_fold_select,
        numpy=lambda predicate, on_false, on_true: np.where(predicate, on_true, on_false),
        python=lambda predicate, on_false, on_true: on_true if predicate else on_false,
        takes_whole=True,
        derivative=_derive_select,
        transpose=_transpose_select,
        stablehlo=lambda predicate, on_false, on_true: stablehlo.select(predicate, on_true, on_false),
        llvm=_llvm_select,
        accepts=lambda call: True,  # a truth and two of any kind; in loops a number and several
        c="{0} ? {2} : {1}",
        c_of_whole="{0} ? {2} : {1}",
    ),
    ScalarOperation(
        # One of several numbers, by a whole number that is within their range (`Graph.lookup`).
        name="lookup",
        jax=_lookup,
        primitives=(),
        python=lambda index, *cases: cases[index],
        takes_whole=True,
        derivative=_derive_lookup,
        transpose=_transpose_lookup,
        llvm=_llvm_lookup,
        accepts=lambda call: True,
        c=_c_lookup,
    ),
    # Powers and roots.
    ScalarOperation(
        name="pow",
        jax=lax.pow,
        fold=_fold_power,
        numpy=np.power,
        python=lambda a, b: float(np.power(a, b)),  # Python's gives complex numbers, and errors
        stablehlo=stablehlo.power,
        llvm=_llvm_power,
        library="pow",
        example=(0.5, -0.75),
        accepts=lambda call: call.kinds in ((DOUBLE, DOUBLE), (DOUBLE, WHOLE)),
        c="pow({}, {})",
    ),
    ScalarOperation(
        name="sqrt",
        jax=lax.sqrt,
        fold=_fold_sqrt,
        numpy=np.sqrt,
        python=_root,
        derivative=_derive_sqrt,
        stablehlo=stablehlo.sqrt,
        llvm=_intrinsic("sqrt"),
        c="sqrt({})",
    ),
    ScalarOperation(
        # The square root as a factor of a^(3/2), a^(5/2), ...: with the derivative 0 at 0, where the root alone has
        # infinity. It differs from the root in its derivative alone, so what is written is the root.
        name="root_guarded_at_zero",
        jax=_root_guarded_at_zero,
        primitives=(),
        numpy=np.sqrt,
        python=_root,
        stablehlo=stablehlo.sqrt,
        llvm=_intrinsic("sqrt"),
        c="root_guarded_at_zero({})",
    ),
    # Rare as constants; JAX evaluates those of operations without `numpy`.
    ScalarOperation(name="rsqrt", jax=lax.rsqrt_p.bind, llvm=_llvm_rsqrt, c="1.0 / sqrt({})"),
    _function("cbrt", np.cbrt),
    ScalarOperation(name="square", expand=_expand_square, accepts=same(DOUBLE, WHOLE)),
    ScalarOperation(name="integer_pow", expand=_expand_integer_power),
    # This one and `log2` are primitives since JAX 0.11, `polynomial` since 0.12.
    ScalarOperation(name="one_minus_square", expand=_expand_one_minus_square),
    ScalarOperation(name="polynomial", expand=_expand_polynomial),
    # Exponentials and logarithms.
    _function("exp", np.exp),
    _function("exp2", np.exp2),
    _function("expm1", np.expm1),
    _function("log", np.log),
    _function("log1p", np.log1p),
    # In a loop by the library's own, which is exact for powers of 2.
    ScalarOperation(name="log2", fold=_fold_log2, llvm=_in_library("log2"), library="log2"),
    ScalarOperation(name="logistic", jax=lax.logistic_p.bind, llvm=_llvm_logistic, c="1.0 / (1.0 + exp(-{}))"),
    # Circular and hyperbolic functions.
    _function("sin", np.sin, python=_sine),
    _function("cos", np.cos, python=_cosine),
    _function("tan", np.tan),
    _function("asin", np.arcsin),
    _function("acos", np.arccos),
    _function("atan", np.arctan),
    _function("atan2", np.arctan2, python=math.atan2, example=(0.5, -0.75)),
    _function("sinh", np.sinh),
    _function("cosh", np.cosh),
    _function("tanh", np.tanh),
    _function("asinh", None),
    _function("acosh", None, example=(1.5,)),
    _function("atanh", None),
    # JAX takes their derivatives by the bits of a number since 0.11, which scalar programs do not know.
    _function("erf", None, partials=(lambda x: _OF_ERF * lax.exp(-x * x),)),
    _function("erfc", None, partials=(lambda x: -_OF_ERF * lax.exp(-x * x),)),
    # Pieces of numbers.
    ScalarOperation(
        name="abs",
        jax=lax.abs_p.bind,
        numpy=np.abs,
        python=abs,
        stablehlo=stablehlo.abs,
        llvm=_llvm_abs,
        accepts=same(DOUBLE, WHOLE),
        c="fabs({})",
    ),
    ScalarOperation(
        name="sign", jax=lax.sign_p.bind, numpy=np.sign, llvm=_llvm_sign, accepts=same(DOUBLE, WHOLE), c="sign_of({})"
    ),
    ScalarOperation(name="floor", jax=lax.floor_p.bind, numpy=np.floor, llvm=_intrinsic("floor"), c="floor({})"),
    ScalarOperation(name="ceil", jax=lax.ceil_p.bind, numpy=np.ceil, llvm=_intrinsic("ceil"), c="ceil({})"),
    ScalarOperation(
        name="round",
        jax=lax.round_p.bind,
        llvm=_llvm_round,
        c=lambda call: "nearbyint({})" if _rounds_to_even(call) else "round({})",
    ),
    ScalarOperation(
        name="rem",
        jax=lax.rem_p.bind,
        numpy=_remainder,
        llvm=_llvm_rem,
        accepts=same(DOUBLE, WHOLE),
        library="fmod",
        example=(2.5, 0.75),
        c="fmod({}, {})",
        c_of_whole="remainder_of({}, {})",
    ),
    _function("nextafter", None, example=(0.5, 1.0)),
    ScalarOperation(
        name="is_finite", jax=lax.is_finite_p.bind, numpy=np.isfinite, llvm=_llvm_is_finite, c="is_finite({})"
    ),
    # The larger, the smaller, what lies between.
    _on_two(
        "max", _ORDERED, np.maximum, stablehlo.maximum, _extremum("max"), "larger({}, {})", "{0} > {1} ? {0} : {1}"
    ),
    _on_two(
        "min", _ORDERED, np.minimum, stablehlo.minimum, _extremum("min"), "smaller({}, {})", "{0} < {1} ? {0} : {1}"
    ),
    ScalarOperation(
        name="clamp",
        jax=lax.clamp_p.bind,
        numpy=lambda low, x, high: np.minimum(np.maximum(low, x), high),
        llvm=_llvm_clamp,
        accepts=same(DOUBLE, WHOLE, TRUTH),
        c="smaller(larger({1}, {0}), {2})",
    ),
    # Comparisons; nothing is equal to NaN, and everything differs from it (`une`).
    _comparison("lt", "<", np.less, operator.lt, "olt", "slt"),
    _comparison("le", "<=", np.less_equal, operator.le, "ole", "sle"),
    _comparison("gt", ">", np.greater, operator.gt, "ogt", "sgt"),
    _comparison("ge", ">=", np.greater_equal, operator.ge, "oge", "sge"),
    _comparison("eq", "==", np.equal, operator.eq, "oeq", "eq", (DOUBLE, WHOLE, TRUTH)),
    _comparison("ne", "!=", np.not_equal, operator.ne, "une", "ne", (DOUBLE, WHOLE, TRUTH)),
    ScalarOperation(name="lt_to", fold=_fold_before, llvm=_before("slt"), accepts=same(DOUBLE, WHOLE)),
    ScalarOperation(name="le_to", fold=_fold_not_behind, llvm=_before("sle"), accepts=same(DOUBLE, WHOLE)),
    # Truths, and bits of whole numbers.
    _on_two(
        "and",
        _OF_BITS,
        np.bitwise_and,
        stablehlo.and_,
        _logic("and"),
        "{} & {}",
        "{} & {}",
        fold=_fold_logic("and", False),
    ),
    _on_two(
        "or", _OF_BITS, np.bitwise_or, stablehlo.or_, _logic("or"), "{} | {}", "{} | {}", fold=_fold_logic("or", True)
    ),
    _on_two("xor", _OF_BITS, np.bitwise_xor, None, _logic("xor"), "{} ^ {}", "{} ^ {}"),
    ScalarOperation(
        name="not",
        jax=lax.not_p.bind,
        numpy=np.invert,
        stablehlo=stablehlo.not_,
        llvm=_llvm_not,
        accepts=same(TRUTH, WHOLE),
        c=lambda call: "!{}" if call.kinds == (TRUTH,) else "~{}",
    ),
    # What changes no number.
    ScalarOperation(
        name="convert_element_type",
        fold=_fold_convert,
        copies=True,
        llvm=_llvm_convert,
        accepts=lambda call: True,
    ),
    # What a conversion is in a graph. XLA makes of floats whole numbers of 64 bits as `_integer_of_float` does.
    ScalarOperation(
        name="integer_of_float",
        jax=lambda a: lax.convert_element_type(a, INT),
        primitives=(),
        numpy=_integer_of_float,
        llvm=lambda text, call, a: text.intrinsic("fptosi.sat", DOUBLE, a, result=WHOLE),
        c="integer_of_float({})",
    ),
    ScalarOperation(
        name="float_of_integer",
        jax=lambda a: lax.convert_element_type(a, FLOAT),
        primitives=(),
        numpy=lambda a: np.asarray(a).astype(FLOAT),
        python=float,
        takes_whole=True,
        llvm=lambda text, call, a: text.made(f"sitofp {text.type(WHOLE)} {a} to {text.type(DOUBLE)}"),
        accepts=same(WHOLE),
        c=lambda call: "(double){}",
    ),
    ScalarOperation(
        name="stop_gradient",
        jax=lax.stop_gradient,
        copies=True,
        llvm=lambda text, call, a: a,
        accepts=lambda call: True,
        c="{}",
    ),
    ScalarOperation(
        # A node that has a derivative of its own (`Graph.custom_jvp_node`), and the value of its argument.
        name="custom_jvp_node",
        jax=lambda a: a,
        primitives=(),
        copies=True,
        numpy=lambda a: a,
        transpose=lambda graph, along, arguments, moves: [along],  # what is linear is its own derivative
        stablehlo=lambda a: a,
        llvm=lambda text, call, a: a,
        accepts=lambda call: True,
        c="{}",
    ),
)

OPERATIONS: dict[str, ScalarOperation] = {operation.name: operation for operation in _ALL}
"""By the names that nodes of a graph have."""

OF_PRIMITIVE: dict[str, ScalarOperation] = {
    name: operation
    for operation in _ALL
    for name in ((operation.name,) if operation.primitives is None else operation.primitives)
}
"""By the names of JAX's primitives."""

MAY_OVERFLOW = frozenset([
    "add", "add_any", "sub", "mul", "div", "rem", "neg", "not", "abs", "sign", "square", "integer_pow", "shift_left",
    "convert_element_type", "reduce_sum", "reduce_prod", "dot_general", "cumsum", "cumprod",
])  # fmt: skip
"""Primitives whose result, a whole number that is computed with 64 bits, may be outside of a type of fewer bits, where
JAX's wraps around. Others choose among numbers, or move them."""

LIBRARY: dict[str, str] = {operation.name: operation.library for operation in _ALL if operation.library is not None}
"""Functions of the mathematical library that machine code calls, by the names of the operations that they are."""

INNER_PROGRAM = {
    "custom_jvp_call": "call_jaxpr",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "closed_call": "call_jaxpr",
    "eval_jaxpr": "call_jaxpr",
    "core_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}
"""Primitives that only stand for a program, and the parameter that has it: no operations, but what is in them is.
`custom_vjp_call` is not one: its rule says nothing of tangents, and inlining the function under it would lose it."""


def inner_program(name: str, parameters: Mapping[str, Any]) -> tuple[Any, tuple] | None:
    """The program that a primitive stands for, and its constants; None for one that is an operation."""
    if name not in INNER_PROGRAM:
        return None
    program = parameters[INNER_PROGRAM[name]]  # with its constants, or one that has none
    return getattr(program, "jaxpr", program), getattr(program, "consts", ())
