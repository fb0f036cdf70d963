"""A straight-line scalar program written out as a C function, for machines without Python.

Each operation becomes one statement on doubles (predicates and whole numbers: `int`, `long long`), in the order of the
program, so that a compiler that does not reorder arithmetic (no -ffast-math) and does not contract it (no fused
multiply-add: -ffp-contract=off) gives the numbers of the program itself up to the rounding of the mathematical library.
Compilers that are told to do the former are refused by `#error`; the latter is switched off by pragmas.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from spherejax.compiler.graph import Graph
from spherejax.compiler.operations import BOOL, FLOAT, INT, KINDS, OPERATIONS, Call, NotScalarizable

PRELUDE = """\
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) || defined(_M_FP_FAST) || \\
    defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__)
#error "compile without -ffast-math, -Ofast, -ffinite-math-only, -funsafe-math-optimizations (/fp:fast): NaN would pass"
#endif
/* No fused multiply-add: where two ways to the same number differ by a rounding, contacts begin and end without end. */
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#endif
#include <math.h>
#include <stdint.h>
#include <string.h>

/* By its bits, which no option of a compiler takes for granted. */
static inline int is_finite(double a) {
  uint64_t bits;
  memcpy(&bits, &a, sizeof bits);
  return (bits >> 52 & 0x7ff) != 0x7ff;
}
static inline double larger(double a, double b) { return a != a || a > b ? a : b; }   /* NaN wins, as in the library */
static inline double smaller(double a, double b) { return a != a || a < b ? a : b; }
static inline double sign_of(double a) { return a > 0 ? 1.0 : a < 0 ? -1.0 : a; }
static inline long long integer_of_float(double a) {   /* cut; what is beyond is the nearer bound, and NaN is 0 */
  if (a != a) return 0;
  if (a >= 9223372036854775808.0) return INT64_MAX;
  return a <= -9223372036854775808.0 ? INT64_MIN : (long long)a;
}
static inline long long quotient(long long a, long long b) {
  if (b == 0) return -1;
  return b == -1 ? (long long)(0ULL - (unsigned long long)a) : a / b;
}
static inline long long remainder_of(long long a, long long b) { return b == 0 ? a : b == -1 ? 0 : a % b; }
static inline double root_guarded_at_zero(double a) { return a == 0 ? 0.0 : sqrt(a); }
"""
"""What the functions need in front of them."""


def c_functions(graph: Graph, outputs: Sequence[int], ahead: Sequence[int], n_arguments: int, name: str) -> str:
    """Two C functions: what depends on the first argument alone, and the rest.

        enum { NAME_ahead_size = ... };
        static void NAME_ahead(const double *a0, double *ahead);
        static void NAME(const double *ahead, const double *a0, const double *a1, ..., double *out);

    Args:
        graph: the program.
        outputs: nodes that are returned, flat.
        ahead: nodes that are evaluated by the first function.
        n_arguments: of the program.
        name: of the function.

    Raises:
        NotScalarizable: for an operation that C does not have.
    """
    # A program need not read all of its arguments, of which a C compiler would warn.
    arguments = "".join(f"const double *a{i}, " for i in range(n_arguments))
    unused = "".join(f" (void)a{i};" for i in range(n_arguments))
    place = {node: i for i, node in enumerate(ahead)}
    # Two functions, as in a loop of ours: what depends on parameters alone is evaluated when they are set.
    first = _statements(graph, ahead, {})
    rest = _statements(graph, outputs, {node: _read_ahead(graph, node, i) for node, i in place.items()})
    return "\n".join(
        [
            f"enum {{ {name}_ahead_size = {len(ahead)} }};",
            f"static void {name}_ahead(const double *a0, double *ahead) {{ (void)a0; (void)ahead;",
            *first,
            *(f"  ahead[{i}] = {_name(graph, node)};" for node, i in place.items()),
            "}",
            f"static void {name}(const double *ahead, {arguments}double *out) {{ (void)ahead;{unused}",
            *rest,
            *(f"  out[{i}] = {_name(graph, node)};" for i, node in enumerate(outputs)),
            "}",
            "",
        ]
    )


def _read_ahead(graph: Graph, node: int, place: int) -> str:
    # All that goes ahead is passed on as doubles; a truth is 0 or 1 of them.
    if graph.dtypes[node] == INT and max(map(abs, graph.limits(node))) > LARGEST_EXACT:
        raise NotScalarizable("a whole number that may be no double is not written in C")
    return f"ahead[{place}] != 0" if graph.dtypes[node] == BOOL else f"ahead[{place}]"


LARGEST_EXACT = 2**53
"""Up to which all whole numbers are doubles."""


def _statements(graph: Graph, outputs: Sequence[int], known_texts: dict[int, str]) -> list[str]:
    lines = []
    for node in graph.needed(outputs, known_texts.keys()):
        operation = graph.operations[node]
        if operation == "constant":  # written where it is read: a compiler of C folds it there
            continue
        if node in known_texts:
            text = known_texts[node]
        elif operation == "input":
            argument, entry = graph.parameters[node]
            text = f"a{argument}[{entry}]"
        else:
            text = _written(graph, node, operation)
        lines.append(f"  const {_type(graph.dtypes[node])} {_name(graph, node)} = {text};")
    return lines


def _written(graph: Graph, node: int, operation: str) -> str:
    kinds = tuple(KINDS[graph.dtypes[a]] for a in graph.arguments[node])
    # By the types of its arguments: `and` of truths and of whole numbers are two operators in C.
    call = Call(kinds, KINDS[graph.dtypes[node]], dict(graph.parameters_of(node) or ()))
    text = OPERATIONS[operation].in_c(call, *(_name(graph, a) for a in graph.arguments[node]))
    if text is None:
        raise NotScalarizable(f"the operation {operation!r} is not written in C")
    return text


def _name(graph: Graph, node: int) -> str:
    return _constant(graph.value(node)) if graph.is_constant(node) else f"v{node}"


def _constant(value: Any) -> str:
    if isinstance(value, np.bool_ | bool):  # before `float`: C prints a truth as 1, not as 0x1p+0
        return str(int(value))
    if isinstance(value, np.integer):
        return f"({int(value) + 1}LL - 1)" if value < 0 else f"{int(value)}LL"  # the least one has no literal
    number = float(value)
    if math.isfinite(number):
        return f"({number.hex()})"  # every bit of it
    return "NAN" if math.isnan(number) else "INFINITY" if number > 0 else "(-INFINITY)"


def _type(dtype: np.dtype) -> str:
    return "double" if dtype == FLOAT else "int" if dtype == BOOL else "long long"
