"""Operations of JAX on each entry of arrays, as text; see `array_text`."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from spherejax.compiler.emit.llvm import COMPARED, COMPARED_WHOLE, INTRINSIC, LIBRARY
from spherejax.compiler.emit.llvm_arrays import ArrayText, NotWrittenError, Value, constant, kind_of, vector

Rule = Callable[[ArrayText, Sequence[Value], Any, Sequence[Any]], list[Value]]
"""From the values of an operation's arguments, its parameters, and its results' shapes and types, to the results."""


def _by_entry(write: Callable[..., str]) -> Rule:
    """An operation of each entry; `write` has the text, the kind of the arguments, a width, and names."""

    def rule(text: ArrayText, values: Sequence[Value], parameters: Any, avals: Sequence[Any]) -> list[Value]:
        (aval,) = avals
        kind = values[-1].kind
        how = partial(write, text, kind, parameters)
        return [text.entrywise(aval.shape, kind_of(aval.dtype), values, how)]

    return rule


def _number(text: ArrayText, x: float, kind: str, width: int) -> str:
    return text.spread(constant(x, kind), kind, width)


def arithmetic(word: str) -> Callable[..., str]:
    """A sum, a difference or a product."""

    def write(text, kind, parameters, width, a, b):
        del parameters
        if kind == "i1":
            raise NotWrittenError(f"{word} of truths")
        word_of_kind = f"f{word} contract" if kind == "double" else word
        return text.made(f"{word_of_kind} {vector(kind, width)} {a}, {b}")

    return write


def _div(text, kind, parameters, width, a, b):
    del parameters
    if kind != "double":
        raise NotWrittenError("a division of whole numbers")
    return text.made(f"fdiv {vector(kind, width)} {a}, {b}")


def _neg(text, kind, parameters, width, a):
    del parameters
    typed = vector(kind, width)
    return text.made(f"fneg {typed} {a}" if kind == "double" else f"sub {typed} {_number(text, 0, kind, width)}, {a}")


def extremum(word: str) -> Callable[..., str]:
    """The larger or the smaller one, `max` or `min`; NaN wins."""

    def write(text, kind, parameters, width, a, b):
        del parameters
        if kind == "i1":
            return text.made(f"{'or' if word == 'max' else 'and'} {vector(kind, width)} {a}, {b}")
        return text.intrinsic(f"{word}imum" if kind == "double" else f"s{word}", kind, width, a, b)

    return write


def _compared(name: str) -> Callable[..., str]:
    def write(text, kind, parameters, width, a, b):
        del parameters
        word = f"fcmp {COMPARED[name]}" if kind == "double" else f"icmp {COMPARED_WHOLE[name]}"
        if kind == "i1" and name not in ("eq", "ne"):
            raise NotWrittenError(f"{name} of truths")
        return text.made(f"{word} {vector(kind, width)} {a}, {b}")

    return write


def logic(word: str) -> Callable[..., str]:
    """Of truths, or of the bits of whole numbers."""
    return lambda text, kind, parameters, width, a, b: text.made(f"{word} {vector(kind, width)} {a}, {b}")


def _not(text, kind, parameters, width, a):
    del parameters
    return text.made(f"xor {vector(kind, width)} {a}, {_number(text, True if kind == 'i1' else -1, kind, width)}")


def _abs(text, kind, parameters, width, a):
    if kind == "double":
        return text.intrinsic("fabs", kind, width, a)
    return text.intrinsic("smax", kind, width, a, _neg(text, kind, parameters, width, a))


def _sign(text, kind, parameters, width, a):
    if kind != "double":
        raise NotWrittenError("the sign of a whole number")
    typed, truth, zero = vector(kind, width), vector("i1", width), _number(text, 0, kind, width)
    above, below = (text.made(f"fcmp {word} {typed} {a}, {zero}") for word in ("ogt", "olt"))
    found = text.made(f"select {truth} {below}, {typed} {_number(text, -1, kind, width)}, {typed} {a}")
    return text.made(f"select {truth} {above}, {typed} {_number(text, 1, kind, width)}, {typed} {found}")


def _of_floats(write: Callable[..., str]) -> Callable[..., str]:
    def only(text, kind, parameters, width, *names):
        if kind != "double":
            raise NotWrittenError("a function of whole numbers")
        return write(text, parameters, width, *names)

    return only


def _integer_power(text, parameters, width, a):
    exponent, typed, found = parameters["y"], vector("double", width), None
    left, base = abs(exponent), a
    while left:
        if left & 1:
            found = base if found is None else text.made(f"fmul contract {typed} {found}, {base}")
        left >>= 1
        if left:
            base = text.made(f"fmul contract {typed} {base}, {base}")
    one = _number(text, 1, "double", width)
    found = one if found is None else found
    return text.made(f"fdiv {typed} {one}, {found}") if exponent < 0 else found


def _one_over_root(text, parameters, width, a):
    del parameters
    root = text.intrinsic("sqrt", "double", width, a)
    return text.made(f"fdiv {vector('double', width)} {_number(text, 1, 'double', width)}, {root}")


def _square(text, kind, parameters, width, a):
    return arithmetic("mul")(text, kind, parameters, width, a, a)


def _is_finite(text, parameters, width, a):
    del parameters
    size = text.intrinsic("fabs", "double", width, a)
    return text.made(f"fcmp olt {vector('double', width)} {size}, {_number(text, np.inf, 'double', width)}")


def _clamp(text, kind, parameters, width, low, x, high):
    most = extremum("max")(text, kind, parameters, width, low, x)
    return extremum("min")(text, kind, parameters, width, most, high)


def _one_minus_square(text, parameters, width, a):
    del parameters
    typed, one = vector("double", width), _number(text, 1, "double", width)
    above, below = text.made(f"fadd {typed} {one}, {a}"), text.made(f"fsub {typed} {one}, {a}")
    return text.made(f"fmul {typed} {above}, {below}")


def _polynomial(text, parameters, width, x, *coefficients):
    """By Horner's rule; the coefficients from the lowest degree on."""
    del parameters
    typed, (*lower, found) = vector("double", width), coefficients
    for each in reversed(lower):
        product = text.made(f"fmul contract {typed} {x}, {found}")
        found = text.made(f"fadd contract {typed} {each}, {product}")
    return found


def _library(name: str) -> Callable[..., str]:
    word = "fmod" if name == "rem" else name
    return _of_floats(lambda text, parameters, width, *names: text.library(word, width, *names))


def _logistic(text, parameters, width, a):
    del parameters
    typed, one = vector("double", width), _number(text, 1, "double", width)
    falling = text.library("exp", width, text.made(f"fneg {typed} {a}"))
    return text.made(f"fdiv {typed} {one}, {text.made(f'fadd {typed} {one}, {falling}')}")


def select(text: ArrayText, values: Sequence[Value], parameters: Any, avals: Sequence[Any]) -> list[Value]:
    """`jax.lax.select_n`."""
    del parameters
    (aval,), (which, *cases) = avals, values
    kind = cases[0].kind

    def write(width, number, *names):
        typed, truth = vector(kind, width), vector("i1", width)
        if which.kind == "i1":
            on_false, on_true = names
            return text.made(f"select {truth} {number}, {typed} {on_true}, {typed} {on_false}")
        found = names[-1]
        for at in range(len(names) - 2, -1, -1):
            is_it = text.made(f"icmp eq {vector('i64', width)} {number}, {_number(text, at, 'i64', width)}")
            found = text.made(f"select {truth} {is_it}, {typed} {names[at]}, {typed} {found}")
        return found

    return [text.entrywise(aval.shape, kind, values, write)]


def _convert(text, values, parameters, avals):
    (aval,), (value,) = avals, values
    target, source = kind_of(aval.dtype), value.kind
    if parameters["new_dtype"] == np.int32 and source == "double":
        raise NotWrittenError("a number of 64 bits as one of 32")
    if target == source:
        return [value.as_shape(aval.shape)]

    def write(width, a):
        typed, to = vector(source, width), vector(target, width)
        if target == "i1":
            word = "fcmp une" if source == "double" else "icmp ne"
            return text.made(f"{word} {typed} {a}, {_number(text, 0, source, width)}")
        if source == "double":
            mark, whole = (f"v{width}f64", f"v{width}i64") if width > 1 else ("f64", "i64")
            name = f"@llvm.fptosi.sat.{whole}.{mark}"
            text.declared[f"declare {to} {name}({typed})"] = None
            return text.made(f"call {to} {name}({typed} {a})")
        word = {("i1", "i64"): "zext", ("i1", "double"): "uitofp", ("i64", "double"): "sitofp"}[source, target]
        return text.made(f"{word} {typed} {a} to {to}")

    return [text.entrywise(aval.shape, target, values, write)]


def _pow(text, values, parameters, avals):
    base, exponent = values
    if exponent.kind != "double":
        (exponent,) = _convert(
            text, [exponent], {"new_dtype": np.dtype(float)}, [jax.ShapeDtypeStruct(exponent.shape, float)]
        )
    return _by_entry(_library("pow"))(text, [base, exponent], parameters, avals)


_OF_EACH = {
    **{name: arithmetic(name) for name in ("add", "sub", "mul")},
    "add_any": arithmetic("add"),
    "div": _div,
    "neg": _neg,
    "max": extremum("max"),
    "min": extremum("min"),
    **{name: _compared(name) for name in COMPARED},
    **{name: logic(name) for name in ("and", "or", "xor")},
    "not": _not,
    "abs": _abs,
    "sign": _sign,
    "square": _square,
    "clamp": _clamp,
    "integer_pow": _of_floats(_integer_power),
    "rsqrt": _of_floats(_one_over_root),
    "is_finite": _of_floats(_is_finite),
    "logistic": _of_floats(_logistic),
    "one_minus_square": _of_floats(_one_minus_square),
    "polynomial": _of_floats(_polynomial),
    "log2": _library("log2"),
    **{
        name: _of_floats(lambda text, parameters, width, a, word=word: text.intrinsic(word, "double", width, a))
        for name, word in INTRINSIC.items()
        if name in ("sqrt", "floor", "ceil")
    },
    **{name: _library(name) for name in LIBRARY if name != "pow"},
}

RULES: dict[str, Rule] = {
    **{name: _by_entry(write) for name, write in _OF_EACH.items()},
    "pow": _pow,
    "select_n": select,
    "convert_element_type": _convert,
}
