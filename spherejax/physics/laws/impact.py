"""What a hysteresis factor does to a free impact, in closed form.

Two bodies of effective mass m meet at the speed v under f = K delta**n (1 + chi delta_rate/v) and part at e
v. Integrating m delta_rate d(delta_rate) = -f d(delta) from onset to separation eliminates K, n, m and v:

    chi (1 + e) = ln[(1 + chi)/(1 - chi e)]                                                    (*)

With s = chi (1 + e) this reads 1 + chi = s/(1 - exp(-s)) and 1 - chi e = s/(exp(s) - 1). The difference of
the two holds by itself; either of them, with x = s/2, becomes an explicit pair in the Langevin function
L(x) = coth(x) - 1/x:

    e = (1 - L(x))/(1 + L(x)),    chi = x (1 + L(x)) = 2 x/(1 + e)

so chi from e is an inverse Langevin function, known from rubber elasticity, and e from chi a scalar equation
without cancellation.

Source: (*) follows for n = 1.5 from the dissipation argument in Gonthier et al. (2004), Multibody Syst. Dyn.
11:209-233; the reduction to the Langevin function is derived above.
"""

import math
from typing import Any

import jax.numpy as jnp

from spherejax.foundations.numerics import BERNOULLI, horner
from spherejax.foundations.types import Number, Scalar

_SERIES_RADIUS = 0.5
"""Below it coth(x) - 1/x has lost more than a digit; the 11 terms of the series leave 1e-18 there."""

_LANGEVIN_SERIES = tuple(
    float(4**k * b / math.factorial(2 * k)) for k, b in enumerate(BERNOULLI, start=1)
)  # of L(x)/x in x**2: Abramowitz and Stegun (1964), 4.5.67

_NEWTON_STEPS = 4
"""The start is good to 2e-3, so the steps leave 1e-5, 1e-10, 1e-20: three for the value, four for its
derivatives."""

_PENETRATION_SERIES = tuple((-1.0) ** k / (k + 2) for k in range(14))
_PENETRATION_RADIUS = 0.05
"""Below it chi - ln(1 + chi) has lost two digits; the series leaves 0.05**14 = 6e-19."""


def exact_hysteresis_factor(restitution: Number, xp: Any = jnp) -> Scalar:
    """The hysteresis factor chi whose free impact realizes the prescribed restitution [-].

        chi = 2 x/(1 + e),    L(x) = (1 - e)/(1 + e)

    by a rational start and a fixed number of Newton steps, so that the derivatives of the last step are
    those of the implicit function. For x above 1/2 the residual is formed from 1 - L = 2 e/(1 + e), which
    keeps its digits as e tends to 0.

    Args:
        restitution: e in (0, 1]; meant from 1e-50 up, where squares still do not underflow.
        xp: `jax.numpy`, or NumPy for a number that is known.

    Limits: e -> 1: chi = 3 (1 - e)/2 + ..., derivative -3/2. e -> 0: chi = 1/e with a relative error
    exp(-1/e)/e.

    Source: derived here (module docstring). The start is the approximant of Kroeger (2015), J. Non-Newtonian
    Fluid Mech. 223:77-87, with a relative error below 2e-3.
    """
    e = xp.asarray(restitution)
    y = (1.0 - e) / (1.0 + e)
    y2 = y * y
    complement = 2.0 * e / (1.0 + e)
    x = y * (3.0 - y2 * (6.0 + y2 * (1.0 - 2.0 * y2)) / 5.0) * (1.0 + e) ** 2 / (4.0 * e)
    for _ in range(_NEWTON_STEPS):
        near = x < _SERIES_RADIUS
        x_near = xp.where(near, x, 0.0)
        x_far = xp.where(near, 1.0, x)
        ratio = horner(_LANGEVIN_SERIES, x_near * x_near)
        langevin = ratio * x_near
        decay = xp.exp(-2.0 * x_far)
        residual_far = complement - 1.0 / x_far + 2.0 * decay / (1.0 - decay)
        slope_far = 1.0 / (x_far * x_far) - 4.0 * decay / (1.0 - decay) ** 2
        residual = xp.where(near, langevin - y, residual_far)
        slope = xp.where(near, 1.0 - langevin**2 - 2.0 * ratio, slope_far)
        x = x - residual / slope
    return 2.0 * x / (1.0 + e)


def realized_restitution(hysteresis_factor: float) -> float:
    """The restitution e of a free impact under a hysteresis factor chi [-].

    Solves x (1 + L(x)) = chi, convex and increasing, by Newton steps from the right, on the host.

    Args:
        hysteresis_factor: chi >= 0, a concrete number.

    Returns:
        e in (0, 1], to rounding; independent of mass, stiffness, exponent and speed.

    Limits: 1 at chi = 0 (slope -2/3); 1/chi for large chi, never above it: no factor makes an impact fully
    plastic.
    """
    chi = float(hysteresis_factor)
    if not 0.0 <= chi < math.inf:
        raise ValueError(f"hysteresis factor = {chi} must be finite and not negative. Check the restitution.")
    x = chi
    for _ in range(100):
        langevin, slope = _langevin(x)
        step = (x * (1.0 + langevin) - chi) / (1.0 + langevin + x * slope)
        x -= step
        if abs(step) <= 1e-16 * x:
            break
    langevin, _ = _langevin(x)
    complement = 1.0 - langevin
    if x >= _SERIES_RADIUS:
        complement = 1.0 / x - 2.0 / math.expm1(2.0 * x) if x < 300.0 else 1.0 / x  # expm1 overflows at 355
    return complement / (1.0 + langevin)


def maximum_penetration(
    mass: Number, impact_rate: Number, hysteresis_factor: Number, stiffness: Number, exponent: Number = 1.5
) -> Scalar:
    """Largest penetration of a free impact [m].

        delta_max**(n+1) = (n + 1) m v**2/K * (chi - ln(1 + chi))/chi**2

    Args:
        mass: effective mass m_i m_j/(m_i + m_j) [kg].
        impact_rate: penetration rate v at the onset [m/s], positive.
        hysteresis_factor: chi [-].
        stiffness: K [N/m**n].
        exponent: n [-].

    Limits: at chi = 0 the last factor is 1/2 (its derivative -1/3), so K delta_max**(n+1)/(n+1) = m v**2/2.

    Source: the first half of the integral in the module docstring.
    """
    chi = jnp.asarray(hysteresis_factor)
    near = chi < _PENETRATION_RADIUS
    chi_near = jnp.where(near, chi, 0.0)
    chi_far = jnp.where(near, 1.0, chi)
    absorbed = jnp.where(
        near, horner(_PENETRATION_SERIES, chi_near), (chi_far - jnp.log1p(chi_far)) / (chi_far * chi_far)
    )
    return ((exponent + 1.0) * mass * impact_rate**2 / stiffness * absorbed) ** (1.0 / (exponent + 1.0))


def _langevin(x: float) -> tuple[float, float]:
    """L(x) and its derivative, on the host."""
    if x < _SERIES_RADIUS:
        ratio = float(horner(_LANGEVIN_SERIES, x * x))
        langevin = ratio * x
        return langevin, 1.0 - langevin**2 - 2.0 * ratio
    decay = math.exp(-2.0 * x)
    return (1.0 + decay) / (1.0 - decay) - 1.0 / x, 1.0 / x**2 - 4.0 * decay / (1.0 - decay) ** 2
