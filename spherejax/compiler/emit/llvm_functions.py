"""Mathematical functions in LLVM's language, for single numbers and for vectors alike.

A mathematical library has functions of one number: a vector has to be taken to pieces, and put together again from
what eight calls give. The functions here have neither tables nor branches, so that one text serves a number and a
vector of any width, and gives a number the same bits in both.

Each reduces its argument to a small interval, where a polynomial, or a quotient of two, is fitted in the sense of the
smallest largest error; `benchmarks/fitted_functions.py` computes all coefficients, and measures errors and times.
Arguments are reduced by x = n ln 2 + r, or x = n pi / 2 + r, in steps all but the last of which are exact, with or
without fused operations (W. J. Cody and W. Waite, Software Manual for the Elementary Functions, 1980).

`fmuladd` is one fused operation where the processor has it, for vectors as for numbers, and two operations elsewhere:
LLVM's `fma` would be a call of a library there.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from spherejax.compiler.operations import DOUBLE, TRUTH, WHOLE, LlvmWriter

_LN2 = 0.6931471805598903, 5.497923018708371e-14
"""The logarithm of 2 as a number of 42 bits, whose products with whole numbers below 2^11 are exact, and the rest."""

_LARGEST = 709.782712893384
"""The largest number of which the exponential is one."""

_LARGEST_SINH = 710.4758600739439
"""The same of the hyperbolic sine and cosine."""

_INVERSE_LN2 = 1.4426950408889634

_SHIFT = 1.5 * 2.0**52
"""A sum with it is rounded to a whole number, which stands in its last bits."""

_EXPONENTIAL = (
    0.5, 0.1666666666666667, 0.041666666666666685, 0.008333333333326134, 0.0013888888888874415, 0.0001984126987482373,
    2.4801587347285244e-05, 2.755725539650596e-06, 2.755725296106792e-07, 2.5105218434670143e-08,
    2.0921575579002486e-09,
)  # fmt: skip
"""Of (e^r - 1 - r) / r^2 for |r| up to ln(2) / 2; within 1.4e-18."""

_SMALL_TANH = 0.625
"""Where the quotient of polynomials ends. There 1 - 2 / (e^2x + 1) has lost one bit to the difference."""

_TANH_ABOVE = -0.33333333333333326, -0.02049685416131152, -0.00019909192188285064
_TANH_BELOW = 1.0, 0.46149056248391995, 0.023288738854707683, 0.00020644150806046119
"""Of (tanh(x) / x - 1) / x^2 by x^2; the error is within 6e-19 of tanh(x)."""

_LOGARITHM = (
    0.666666666666667, 0.3999999999989852, 0.28571428626367495, 0.2222221107770512, 0.1818289287882178,
    0.15331607967599223, 0.14617738802323157,
)  # fmt: skip
"""Of (2 artanh(s) - 2 s) / s^3 by s^2, for s of f = sqrt(2) - 1; within 3.1e-16, of which s^3 is left."""

_HALF_PI = 1.5707963267923333, 2.5633441512663184e-12, 3.2820035428735005e-22
"""Half of pi as two numbers of 36 bits, whose products with whole numbers below 2^17 are exact, and the rest."""

_INVERSE_HALF_PI = 0.6366197723675814

LARGEST_ANGLE = 1e5
"""Of a sine; n is below 2^17."""

_SINE = (
    -0.16666666666666666, 0.008333333333330948, -0.00019841269836757695, 2.7557316101855958e-06,
    -2.505113166489509e-08, 1.5918114424840847e-10,
)  # fmt: skip
"""Of (sin(r) - r) / r^3 by r^2 for |r| up to pi / 4; within 2e-17."""

_COSINE = (
    0.041666666666666664, -0.0013888888888887398, 2.480158729876497e-05, -2.755731727121815e-07,
    2.0876146141661155e-09, -1.1382622210241963e-11,
)  # fmt: skip
"""Of (cos(r) - 1 + r^2 / 2) / r^4, as well; within 1.3e-18."""

_SINH = (
    0.16666666666666669, 0.008333333333330062, 0.00019841269863055054, 2.755726845731689e-06, 2.5100386840281308e-08,
)  # fmt: skip
"""Of (sinh(r) - r) / r^3 by r^2 for |r| up to ln(2) / 2; within 7.9e-18."""

_COSH = (
    0.5000000000000001, 0.04166666666662413, 0.0013888888917216048, 2.4801521291853554e-05, 2.7620090450917575e-07,
)  # fmt: skip
"""Of (cosh(r) - 1) / r^2, as well; within 1e-16."""


def _bits(x: float) -> int:
    return int(np.float64(x).view(np.int64))


class _Formulas:
    """Writes formulas by a writer of LLVM's language."""

    def __init__(self, text: LlvmWriter):
        self._text, self.double, self._whole = text, text.type(DOUBLE), text.type(WHOLE)
        self.add, self.sub, self.mul, self.div = map(self._operation, ("fadd", "fsub", "fmul", "fdiv"))

    def _number(self, a: str | float) -> str:
        return a if isinstance(a, str) else self._text.number(a, DOUBLE)

    def _bits(self, a: str | int) -> str:
        return a if isinstance(a, str) else self._text.number(a, WHOLE)

    def _operation(self, word: str) -> Callable[[Any, Any], str]:
        return lambda a, b: self._text.made(f"{word} {self.double} {self._number(a)}, {self._number(b)}")

    def fma(self, a: str | float, b: str | float, c: str | float) -> str:
        """a b + c."""
        return self._text.intrinsic("fmuladd", DOUBLE, self._number(a), self._number(b), self._number(c))

    def size_of(self, a: str) -> str:
        return self._text.intrinsic("fabs", DOUBLE, a)

    def with_sign(self, a: str, of: str) -> str:
        return self._text.intrinsic("copysign", DOUBLE, a, of)

    def chosen(self, how: str, a: str, b: float, then: str | float, otherwise: str | float) -> str:
        """One of two numbers, by a comparison."""
        is_it = self._text.made(f"fcmp {how} {self.double} {a}, {self._number(b)}")
        numbers = f"{self.double} {self._number(then)}, {self.double} {self._number(otherwise)}"
        return self._text.made(f"select {self._text.type(TRUTH)} {is_it}, {numbers}")

    def within(self, a: str, low: float | None, high: float | None) -> str:
        """A number not beyond bounds; NaN stays NaN."""
        for how, bound in (("olt", low), ("ogt", high)):
            a = a if bound is None else self.chosen(how, a, bound, bound, a)
        return a

    def polynomial(self, x: str, coefficients: Sequence[float], *powers: str) -> str:
        """The sum of c_i x^i, by pairs, fours, eights (G. Estrin): in Horner's order each sum would wait for the last.

        Args:
            x: the variable.
            coefficients: from the lowest degree on.
            powers: x^2, x^4, ..., as far as they are known.
        """
        terms: list[Any] = list(coefficients)
        while len(terms) > 1:
            pairs = [self.fma(b, x, a) for a, b in zip(terms[::2], terms[1::2], strict=False)]
            terms = pairs if len(terms) % 2 == 0 else [*pairs, terms[-1]]
            if len(terms) > 1:
                x, powers = (powers[0], powers[1:]) if powers else (self.mul(x, x), ())
        return terms[0]

    # Bits -------------------------------------------------------------------------------------------------------------

    def whole(self, word: str, a: str | int, b: str | int) -> str:
        """An operation on bits."""
        return self._text.made(f"{word} {self._whole} {self._bits(a)}, {self._bits(b)}")

    def bits_of(self, a: str) -> str:
        return self._text.made(f"bitcast {self.double} {a} to {self._whole}")

    def of_bits(self, a: str) -> str:
        return self._text.made(f"bitcast {self._whole} {a} to {self.double}")

    def by_bit(self, n: str, then: str, otherwise: str) -> str:
        """One of two numbers, by the last bit of n."""
        truth, numbers = self._text.type(TRUTH), f"{self.double} {then}, {self.double} {otherwise}"
        is_odd = self._text.made(f"icmp ne {self._whole} {self.whole('and', n, 1)}, {self._bits(0)}")
        return self._text.made(f"select {truth} {is_odd}, {numbers}")

    def power_of_two(self, n: str, plus: int = 0) -> str:
        """2^(n + plus), for a whole number of which the last twelve bits are given."""
        return self.of_bits(self.whole("add", self.whole("shl", n, 52), (1023 + plus) << 52))


class _Reduced:
    """x = n ln 2 + r, with n the nearest whole number.

    Attributes:
        n: its last twelve bits are those of n.
        r: the rest.
        lost: what r lost when it was rounded.
    """

    def __init__(self, build: _Formulas, x: str):
        shifted = build.fma(x, _INVERSE_LN2, _SHIFT)
        self.n, minus = build.bits_of(shifted), build.sub(_SHIFT, shifted)
        begin = build.fma(minus, _LN2[0], x)
        self._build, self.r = build, build.fma(minus, _LN2[1], begin)
        self._minus, self._begin = minus, begin

    def lost(self) -> str:
        build = self._build
        return build.fma(self._minus, _LN2[1], build.sub(self._begin, self.r))

    def expm1(self, first: str | None) -> str:
        """e^r - 1 - r, or with r in front of it e^r - 1."""
        build, r = self._build, self.r
        square = build.mul(r, r)
        fourth = build.mul(square, square)
        # In two parts, so that they need not wait for each other.
        near = build.polynomial(r, _EXPONENTIAL[:4], square)
        far = build.polynomial(r, _EXPONENTIAL[4:], square, fourth)
        begin = build.mul(square, near) if first is None else build.fma(square, near, first)
        return build.fma(build.mul(square, fourth), far, begin)


def _exp(build: _Formulas, x: str) -> str:
    """2^n e^r; beyond the bounds, where r is any number, 0 or infinity.

    The power is two factors: 2^1024 is no number, and the product of the first one is exact where the second one makes
    it a subnormal number.
    """
    reduced = _Reduced(build, x)
    # Of n + 2048, which is positive: AVX2 has no shift of whole numbers with a sign.
    both = build.whole("sub", reduced.n, _bits(_SHIFT) - 2048)
    half = build.whole("lshr", both, 1)
    power, other = build.power_of_two(half, -1024), build.power_of_two(build.whole("sub", both, half), -1024)
    value = build.mul(build.fma(power, reduced.expm1(reduced.r), power), other)
    # Chosen last, and not the argument first: nothing waits for it.
    return build.chosen("ogt", build.size_of(x), 750.0, build.chosen("ogt", x, 0.0, np.inf, 0.0), value)


def _expm1(build: _Formulas, x: str) -> str:
    """2^n ((1 - 2^-n) + r + (e^r - 1 - r)), the first sum with what its rounding loses; -1 below the bound."""
    reduced = _Reduced(build, x)
    inverse = build.of_bits(build.whole("sub", 1023 << 52, build.whole("shl", reduced.n, 52)))
    # Not beyond 2^1023, of which the inverse is no normal number.
    whole = build.sub(1.0, build.chosen("ogt", x, 45.0, 0.0, inverse))
    sum_of = build.add(whole, reduced.r)
    lost = build.add(build.sub(reduced.r, build.sub(sum_of, whole)), reduced.lost())
    value = build.add(sum_of, build.add(lost, reduced.expm1(None)))
    # Twice, and 2^(n-1): 2^1024 is no number.
    value = build.mul(build.add(value, value), build.power_of_two(reduced.n, -1))
    value = build.chosen("olt", x, -45.0, -1.0, build.chosen("ogt", x, _LARGEST, np.inf, value))
    return build.with_sign(value, x)


def _tanh(build: _Formulas, x: str) -> str:
    """A quotient of polynomials near 0, 1 - 2 / (e^2|x| + 1) further out; of both one quotient is divided.

    From 20 on it is 1.
    """
    size = build.size_of(x)
    square = build.mul(size, size)
    above = build.mul(build.mul(size, square), build.polynomial(square, _TANH_ABOVE))
    below = build.polynomial(square, _TANH_BELOW)
    limited = build.within(size, None, 20.0)
    reduced = _Reduced(build, build.add(limited, limited))
    power = build.power_of_two(reduced.n)
    sum_of = build.fma(power, reduced.expm1(reduced.r), build.add(power, 1.0))
    top = build.chosen("olt", size, _SMALL_TANH, above, -2.0)
    bottom = build.chosen("olt", size, _SMALL_TANH, below, sum_of)
    first = build.chosen("olt", size, _SMALL_TANH, size, 1.0)
    return build.with_sign(build.add(first, build.div(top, bottom)), x)


class _Split:
    """u = 2^k m, m from sqrt(1/2) to sqrt(2), of a positive normal number.

    Attributes:
        k: a number.
        m: the rest.
        inverse: 2^-k.
    """

    def __init__(self, build: _Formulas, u: str):
        bits = build.bits_of(u)
        beyond = build.whole("sub", bits, _bits(np.sqrt(0.5)))
        power = build.whole("and", beyond, -1 << 52)
        self.m = build.of_bits(build.whole("sub", bits, power))
        self.inverse = build.of_bits(build.whole("sub", 1023 << 52, power))
        # k + 1024 in the last bits of 2^52: there are processors that have no vectors of whole numbers as doubles.
        positive = build.whole("lshr", build.whole("add", beyond, 1024 << 52), 52)
        self.k = build.sub(build.of_bits(build.whole("or", positive, _bits(2.0**52))), 2.0**52 + 1024)


def _logarithm(build: _Formulas, k: str, f: str, more: Callable[[str], str] | None = None) -> str:
    """k ln 2 + ln(1 + f), and what `more` makes of f^2 / 2.

    With s = f / (2 + f) it is ln(1 + f) = 2 artanh(s) = 2 s + s^3 R(s^2), and 2 s = f - f^2 / 2 + s f^2 / 2, of which
    the first two terms are large and the last one is small.
    """
    s = build.div(f, build.add(f, 2.0))
    half_square = build.mul(build.mul(f, f), 0.5)
    square = build.mul(s, s)
    rest = build.fma(square, build.polynomial(square, _LOGARITHM), half_square)
    small = build.mul(k, _LN2[1]) if more is None else build.fma(k, _LN2[1], more(half_square))
    return build.fma(k, _LN2[0], build.sub(f, build.sub(half_square, build.fma(s, rest, small))))


def _log(build: _Formulas, x: str) -> str:
    """By the power of two in x; of subnormal numbers by that of 2^54 x."""
    normal = build.chosen("olt", x, 2.0**-1022, build.mul(x, 2.0**54), x)
    split = _Split(build, normal)
    k = build.sub(split.k, build.chosen("olt", x, 2.0**-1022, 54.0, 0.0))
    return _of_positive(build, x, 0.0, _logarithm(build, k, build.sub(split.m, 1.0)))


def _log1p(build: _Formulas, x: str) -> str:
    """By the power of two in u = 1 + x, whose rounding error c is added as 2^-k c / m; where k is 0, of x itself."""
    u = build.add(x, 1.0)
    split = _Split(build, u)
    # Beyond 2^54 u is x, and 2^-k may be no normal number.
    c = build.mul(build.sub(x, build.sub(u, 1.0)), build.chosen("olt", x, 2.0**54, split.inverse, 0.0))
    f = build.chosen("oeq", split.k, 0.0, x, build.sub(split.m, 1.0))
    c = build.chosen("oeq", split.k, 0.0, 0.0, c)

    def more(half_square: str) -> str:  # 1 / m to one digit is enough: 1 - f + f^2
        return build.mul(c, build.fma(half_square, 2.0, build.sub(1.0, f)))

    value = _logarithm(build, split.k, f, more)
    return build.with_sign(_of_positive(build, x, -1.0, value), x)


def _of_positive(build: _Formulas, x: str, end: float, value: str) -> str:
    """A logarithm as it is above an end; there it is -infinity, below NaN, and of infinity and NaN what these are."""
    value = build.chosen("olt", x, np.inf, value, x)
    return build.chosen("ole", x, end, build.chosen("oeq", x, end, -np.inf, np.nan), value)


def _hyperbolic(build: _Formulas, x: str, is_sine: bool) -> str:
    """Of |x| = n ln 2 + r: (p - q) cosh(r) + (p + q) sinh(r), with p = 2^n / 2, q = 2^-n / 2; cosh: both signs changed.

    The largest terms are added with what their rounding loses. Of twice the half, since 2^1024 is no number.
    """
    size = build.size_of(x)
    reduced = _Reduced(build, size)
    p = build.power_of_two(reduced.n, -2)
    inverse = build.of_bits(build.whole("sub", 1021 << 52, build.whole("shl", reduced.n, 52)))
    q = build.chosen("olt", size, 40.0, inverse, 0.0)  # not of 2^1023, of which it is no normal number
    both, apart = build.add(p, q), build.sub(p, q)
    even, odd = (apart, both) if is_sine else (both, apart)
    r, square = reduced.r, build.mul(reduced.r, reduced.r)
    above_one = build.mul(square, build.polynomial(square, _COSH))
    beyond = build.fma(build.mul(r, square), build.polynomial(square, _SINH), reduced.lost())
    small = build.fma(even, above_one, build.mul(odd, beyond))
    linear = build.mul(odd, r)
    total = build.add(even, linear)
    value = build.add(total, build.add(build.sub(linear, build.sub(total, even)), small))
    return build.chosen("ogt", size, _LARGEST_SINH, np.inf, build.add(value, value))


def _sinh(build: _Formulas, x: str) -> str:
    value = build.with_sign(_hyperbolic(build, x, is_sine=True), x)
    return build.chosen("olt", build.size_of(x), 2.0**-28, x, value)  # half of a subnormal number may be none


def _cosh(build: _Formulas, x: str) -> str:
    return _hyperbolic(build, x, is_sine=False)


def _circular(build: _Formulas, x: str, quarters: int) -> str:
    """The sine of x + quarters pi / 2, by x = n pi / 2 + r in three steps; up to `LARGEST_ANGLE`."""
    shifted = build.fma(x, _INVERSE_HALF_PI, _SHIFT)
    number = build.sub(shifted, _SHIFT)
    begin, second = build.fma(number, -_HALF_PI[0], x), build.mul(number, _HALF_PI[1])
    first = build.sub(begin, second)
    rest = build.fma(number, -_HALF_PI[2], build.sub(build.sub(begin, first), second))
    r = build.add(first, rest)
    lost = build.add(build.sub(first, r), rest)
    square = build.mul(r, r)
    half = build.mul(square, 0.5)
    near_one = build.sub(1.0, half)
    # sin(r + lost) = sin(r) + lost (1 - r^2 / 2), cos(r + lost) = cos(r) - lost r.
    bent = build.mul(build.mul(r, square), build.polynomial(square, _SINE))
    sine = build.add(r, build.fma(lost, near_one, bent))
    bent = build.mul(build.mul(square, square), build.polynomial(square, _COSINE))
    behind = build.sub(build.sub(build.sub(1.0, near_one), half), build.mul(lost, r))
    cosine = build.add(near_one, build.add(behind, bent))
    n = build.bits_of(shifted)
    n = build.whole("add", n, quarters) if quarters else n
    value = build.bits_of(build.by_bit(n, cosine, sine))
    return build.of_bits(build.whole("xor", value, build.whole("shl", build.whole("and", n, 2), 62)))


def _sin(build: _Formulas, x: str) -> str:
    return build.chosen("olt", build.size_of(x), 2.0**-28, x, _circular(build, x, 0))  # -0 would be 0


def _cos(build: _Formulas, x: str) -> str:
    return _circular(build, x, 1)


def _by(formula: Callable[..., str]) -> Callable[..., str]:
    return lambda text, *names: formula(_Formulas(text), *names)


FUNCTIONS: dict[str, Callable[..., str]] = {
    "cos": _by(_cos),
    "cosh": _by(_cosh),
    "exp": _by(_exp),
    "expm1": _by(_expm1),
    "log": _by(_log),
    "log1p": _by(_log1p),
    "sin": _by(_sin),
    "sinh": _by(_sinh),
    "tanh": _by(_tanh),
}
"""By their names in the mathematical library; from a `LlvmWriter` and the names of arguments to that of the result."""

WITHIN = {"cos": LARGEST_ANGLE, "sin": LARGEST_ANGLE}
"""The largest size of an argument of a function here; beyond it the library is asked for each number."""

OF_VECTORS_ALONE = {"cos", "log", "log1p", "sin"}
"""Those of which a single number is left to the library, whose tables are faster: a logarithm takes 3 ns in place of 5,
in a vector 1. Both differ by rounding; so do, for other reasons, a run that is alone and the same one among others."""
