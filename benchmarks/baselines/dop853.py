"""DOP853 by hand in numba, for a right-hand side whose contact mode is frozen within a step.

Hairer, Norsett, Wanner (1993), Solving Ordinary Differential Equations I, II.5, II.6 (dense output), II.4 (step
control); coefficients as in SciPy. Each contact onset and release ends a step: the crossing is found on the dense
output, the step is taken again up to there, one correction along the flow brings the penetration to rounding, and the
contact's memory is updated.
"""

import math
from functools import lru_cache

import numpy as np
from numba import njit
from scipy.integrate._ivp import dop853_coefficients as table

from baselines import parameters as at
from baselines.equations import crossing, rate_function
from baselines.written_out import FAST

N_STAGES, N_EXTENDED = table.N_STAGES, table.N_STAGES_EXTENDED
EXPONENT = -1.0 / 8.0
SAFETY, SMALLEST_FACTOR, LARGEST_FACTOR = 0.9, 0.333, 6.0
LANDED = 1e-9
"""Crossing functions below this are at the surface: for a clearance of 0.1 mm, 1e-13 m."""


def _combination(name: str, weights, first: str, scale: str) -> list[str]:
    terms = " + ".join(f"{float(w)!r} * k[{j}, i]" for j, w in enumerate(weights) if w != 0.0)
    return ["    for i in range(y.size):", f"        {name}[i] = {first}{scale}({terms})"]


def _stages(rate, first: int, last: int):
    """Stages first..last-1, written out; the increments of each are in the rows of k."""
    lines = ["def stages(y, h, memory, p, k, z):"]
    for stage in range(first, last):
        lines += _combination("z", table.A[stage, :stage] if stage < N_EXTENDED else table.B, "y[i] + ", "h * ")
        lines.append(f"    rate(z, memory, p, k[{stage}])")
    space = {"rate": rate}
    exec("\n".join(lines), space)
    return njit(space["stages"], fastmath=FAST, error_model="numpy")


def _written(name: str, arguments: str, body: list[str]):
    space: dict = {}
    exec("\n".join([f"def {name}({arguments}):", *body]), space)
    return njit(space[name], fastmath=FAST, error_model="numpy")


_new_state = _written("new_state", "y, h, k, z", _combination("z", table.B, "y[i] + ", "h * "))
_fifth = " + ".join(f"{float(w)!r} * k[{j}, i]" for j, w in enumerate(table.E5) if w != 0.0)
_third = " + ".join(f"{float(w)!r} * k[{j}, i]" for j, w in enumerate(table.E3) if w != 0.0)
_errors = _written(
    "errors",
    "k, e5, e3, y",
    ["    for i in range(y.size):", f"        e5[i] = {_fifth}", f"        e3[i] = {_third}"],
)
_dense_rows = [line for row in range(4) for line in _combination(f"d[{3 + row}]", table.D[row], "", "h * ")]
_dense_tail = _written("dense_tail", "y, h, k, d", [line.replace("][i]", ", i]") for line in _dense_rows])


@njit(fastmath=FAST, error_model="numpy")
def _error_norm(y, z, h, k, e5, e3, rtol, atol):
    _errors(k, e5, e3, y)
    fifth, third = 0.0, 0.0
    for i in range(y.size):
        scale = 1.0 / (atol + rtol * max(abs(y[i]), abs(z[i])))
        fifth += (e5[i] * scale) ** 2
        third += (e3[i] * scale) ** 2
    if fifth == 0.0:
        return 0.0
    return abs(h) * fifth / math.sqrt((fifth + 0.01 * third) * y.size)


@njit(fastmath=FAST, error_model="numpy")
def _interpolated(y, x, d, out):
    """The dense output at the fraction x."""
    for i in range(y.size):
        v = d[6, i] * x
        v = (v + d[5, i]) * (1 - x)
        v = (v + d[4, i]) * x
        v = (v + d[3, i]) * (1 - x)
        v = (v + d[2, i]) * x
        v = (v + d[1, i]) * (1 - x)
        out[i] = y[i] + (v + d[0, i]) * x


@njit(fastmath=FAST, error_model="numpy")
def _prepare_dense(y, z, h, k, d):
    """Coefficients of the dense output; needs stages 12 (the rate at the end) to 15."""
    for i in range(y.size):
        change = z[i] - y[i]
        d[0, i] = change
        d[1, i] = h * k[0, i] - change
        d[2, i] = 2 * change - h * (k[12, i] + k[0, i])
    _dense_tail(y, h, k, d)


@njit(fastmath=FAST, error_model="numpy")
def _fraction_of_crossing(y, d, p, sign, high, w):
    """Where in (0, high] sign times the crossing function reaches zero on the dense output."""
    low, x = 0.0, 0.5 * high
    for _ in range(60):
        _interpolated(y, x, d, w)
        g, _ = crossing(w, p)
        if sign * g > 0.0:
            high = x
        else:
            low = x
        if high - low < 1e-3:
            break
        x = 0.5 * (low + high)
    x0, x1 = low, high
    _interpolated(y, x0, d, w)
    g0 = crossing(w, p)[0]
    _interpolated(y, x1, d, w)
    g1 = crossing(w, p)[0]
    for _ in range(8):
        if g1 == g0 or x1 == x0:
            break
        x = x1 - g1 * (x1 - x0) / (g1 - g0)
        x = min(max(x, low), high)
        x0, g0, x1 = x1, g1, x
        _interpolated(y, x1, d, w)
        g1 = crossing(w, p)[0]
        if abs(g1) < 1e-3 * LANDED:
            break
    return x1


@njit(fastmath=FAST, error_model="numpy")
def _hump(g0, slope0, g1, slope1):
    """Fraction at which the cubic through both ends has its maximum, if it rises first and falls last, else 0."""
    if not (slope0 > 0.0 and slope1 < 0.0):
        return 0.0
    c2, c3 = 3 * (g1 - g0) - 2 * slope0 - slope1, 2 * (g0 - g1) + slope0 + slope1
    discriminant = c2 * c2 - 3 * c3 * slope0
    x = slope0 / (-c2 + math.sqrt(max(discriminant, 0.0)))
    top = g0 + x * (slope0 + x * (c2 + x * c3))
    # The cubic need not be exact: what comes near the surface is looked at on the dense output.
    return x if top > -0.02 else 0.0


@lru_cache(maxsize=8)
def integrator(kind: str):
    """The compiled integrator `run(y0, ts, rtol, atol, p, ys) -> (steps, onsets)` for a joint model.

    `ys` receives the states at the increasing times `ts` (the first is the start); steps are those tried.
    """
    rate = rate_function(kind)
    stages, more_stages = _stages(rate, 1, N_STAGES), _stages(rate, N_STAGES + 1, N_EXTENDED)
    has_contact = kind in ("dry", "lubricated")
    n = at.N_STATE

    @njit(fastmath=FAST, error_model="numpy")
    def run(y0, ts, rtol, atol, p, ys):
        y, z, w = y0.copy(), np.empty(n), np.empty(n)
        k, d = np.empty((N_EXTENDED, n)), np.empty((7, n))
        e5, e3 = np.empty(n), np.empty(n)
        after = np.zeros(2)  # first steps after the last release and the last onset
        t, end, memory = ts[0], ts[-1], 0.0
        sample, steps, onsets = 1, 0, 0
        ys[0] = y
        g, g_rate = 0.0, 0.0
        if has_contact:
            g, g_rate = crossing(y, p)
        rate(y, memory, p, k[0])
        h = 1e-6 * (end - t)
        is_first, was_rejected = False, False
        while t < end:
            h = min(h, end - t)
            if h < 1e-15 * end:
                t = end
                for i in range(sample, ts.size):
                    ys[i] = y
                break
            steps += 1
            stages(y, h, memory, p, k, w)
            _new_state(y, h, k, z)
            error = _error_norm(y, z, h, k, e5, e3, rtol, atol)
            if not error < 1.0:
                h *= max(SMALLEST_FACTOR, SAFETY * error**EXPONENT) if error == error else 0.1
                was_rejected = True
                continue
            factor = LARGEST_FACTOR if error == 0.0 else min(LARGEST_FACTOR, SAFETY * error**EXPONENT)
            if was_rejected:
                factor = min(factor, 1.0)
            was_rejected = False
            rate(z, memory, p, k[12])
            next_h = h * factor
            has_dense, lands = False, False
            if has_contact:
                sign = -1.0 if memory > 0.0 else 1.0
                g_end, g_end_rate = crossing(z, p)
                high = 1.0 if sign * g_end > LANDED else 0.0
                top = 0.0
                if high == 0.0:
                    top = _hump(sign * g, sign * h * g_rate, sign * g_end, sign * h * g_end_rate)
                if high > 0.0 or top > 0.0:
                    more_stages(y, h, memory, p, k, w)
                    _prepare_dense(y, z, h, k, d)
                    has_dense = True
                    if top > 0.0:
                        _interpolated(y, top, d, w)
                        high = top if sign * crossing(w, p)[0] > LANDED else 0.0
                lands = high > 0.0
                if lands:
                    # The step again, up to the crossing, then along the flow by what is left.
                    h *= _fraction_of_crossing(y, d, p, sign, high, w)
                    stages(y, h, memory, p, k, w)
                    _new_state(y, h, k, z)
                    rate(z, memory, p, k[12])
                    steps += 1
                    has_dense = False
                    g_end, g_end_rate = crossing(z, p)
                    rest = -g_end / g_end_rate
                    if abs(rest) < 0.1 * h:
                        for i in range(n):
                            z[i] += rest * k[12, i]
                        h += rest
                        rate(z, memory, p, k[12])
                        g_end, g_end_rate = crossing(z, p)
                g, g_rate = g_end, g_end_rate
            while sample < ts.size and ts[sample] <= t + h:
                if ts[sample] == t + h:
                    ys[sample] = z
                else:
                    if not has_dense:
                        more_stages(y, h, memory, p, k, w)
                        _prepare_dense(y, z, h, k, d)
                        has_dense = True
                    _interpolated(y, (ts[sample] - t) / h, d, ys[sample])
                sample += 1
            t += h
            y, z = z, y
            for i in range(n):
                k[0, i] = k[12, i]
            if is_first and not lands:
                after[1 if memory > 0.0 else 0] = h
                is_first = False
            h = next_h
            if lands:
                if memory > 0.0:
                    memory = 0.0
                else:
                    memory = max(g_rate * p[at.CLEARANCE], 1e-12)
                    onsets += 1
                rate(y, memory, p, k[0])
                is_first = True
                expected = after[1 if memory > 0.0 else 0]
                h = expected if expected > 0.0 else 0.1 * h
        ys[ts.size - 1] = y
        return steps, onsets

    return run
