"""Exponentials, logarithms, circular and hyperbolic functions of decimal numbers, as exact as the context says."""

import decimal
from collections.abc import Callable
from decimal import Decimal
from functools import cache


def expm1(x: Decimal) -> Decimal:
    if abs(x) > Decimal("1e-3"):
        return x.exp() - 1
    total, term = Decimal(0), Decimal(1)
    for k in range(1, 25):
        term *= x / k
        total += term
    return total


def tanh(x: Decimal) -> Decimal:
    return expm1(2 * x) / (expm1(2 * x) + 2)


def log1p(x: Decimal) -> Decimal:
    if abs(x) > Decimal("1e-3"):
        return (1 + x).ln()
    s = x / (2 + x)
    return 2 * sum((s ** (2 * k + 1) / (2 * k + 1) for k in range(10)), Decimal(0))


def sinh(x: Decimal) -> Decimal:
    return (expm1(x) - expm1(-x)) / 2


@cache
def two_pi() -> Decimal:
    """By J. Machin: pi = 16 arctan(1/5) - 4 arctan(1/239)."""
    with decimal.localcontext(prec=400):
        parts = [(Decimal((-1) ** k) / (2 * k + 1), 2 * k + 1) for k in range(290)]
        return 2 * sum((a * (16 * Decimal("0.2") ** n - 4 / Decimal(239) ** n) for a, n in parts), Decimal(0))


def sin(x: Decimal, quarters: int = 0) -> Decimal:
    with decimal.localcontext(prec=400):
        x = x + quarters * two_pi() / 4
        x = x - (x / two_pi()).to_integral_value() * two_pi()
    total, term = Decimal(0), x
    for k in range(2, 60, 2):
        total, term = total + term, -term * x * x / (k * (k + 1))
    return total


EXACT: dict[str, Callable[[Decimal], Decimal]] = {
    "cos": lambda x: sin(x, 1),
    "cosh": lambda x: (x.exp() + (-x).exp()) / 2,
    "exp": Decimal.exp,
    "expm1": expm1,
    "log": Decimal.ln,
    "log1p": log1p,
    "sin": sin,
    "sinh": sinh,
    "tanh": tanh,
}
BEGINS = {"log": 0.0, "log1p": -1.0}
"""Where a function begins, but for which it is one of all numbers."""
