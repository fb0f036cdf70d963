"""The same hand-written right-hand side with LSODA, CVODE and Radau. Each package is optional.

A runner takes (problem, ts, rtol, atol) and returns the states at `ts`. Only CVODE locates contact onsets here: it is
stopped at each by its own root finding, the memory is updated, and it starts anew. LSODA and Radau are run on the
models without a contact.
"""

from functools import lru_cache

import numpy as np
from numba import carray, cfunc, njit

from baselines.equations import crossing, rate_function
from baselines.parameters import CLEARANCE, N_STATE, Problem

MOST_EVENTS = 500
"""A run with more onsets and releases has lost the motion: the four-bar has some 60 in two seconds."""


def lsoda(problem: Problem, ts, rtol: float, atol: float) -> np.ndarray:
    """LSODA in C++ (numbalsoda), called from numba: no Python within the integration."""
    ys, succeeded = _numbalsoda().lsoda(
        _lsoda_rate(problem.kind).address, problem.y0, ts, problem.parameters, rtol=rtol, atol=atol, mxstep=1_000_000
    )
    if not succeeded:
        raise RuntimeError("LSODA did not reach the end")
    return ys


def _numbalsoda():
    import numbalsoda

    return numbalsoda


@lru_cache(maxsize=8)
def _lsoda_rate(kind: str):
    rate = rate_function(kind)

    @cfunc(_numbalsoda().lsoda_sig)
    def callback(t, y, out, p):
        rate(carray(y, (N_STATE,)), 0.0, carray(p, (77,)), carray(out, (N_STATE,)))

    return callback


def cvode(problem: Problem, ts, rtol: float, atol: float) -> np.ndarray:
    """CVODE's BDF (scikit-sundae), stopped at every contact onset and release."""
    from sksundae.cvode import CVODE

    rate, p = rate_function(problem.kind), problem.parameters
    memory, n_events = 0.0, 0

    def right_side(t, y, out):
        rate(y, memory, p, out)

    def surface(t, y, events):
        events[0] = _plain_crossing(y, p)

    options = {"method": "BDF", "rtol": rtol, "atol": atol, "max_num_steps": 10_000_000}
    has_contact = problem.kind in ("dry", "lubricated")
    if has_contact:
        options |= {"eventsfn": surface, "num_events": 1}
    ys, y, t, sample = np.empty((ts.size, N_STATE)), problem.y0.copy(), ts[0], 1
    ys[0] = y
    while sample < ts.size:
        if has_contact:
            surface.terminal, surface.direction = [True], [-1 if memory > 0 else 1]
        # Given two times it returns every step, so the last interval gets its middle as well.
        middle = [(t + ts[-1]) / 2] if sample == ts.size - 1 else []
        solution = CVODE(right_side, **options).solve(np.concatenate([[t], middle, ts[sample:]]), y)
        if solution.status < 0:
            raise RuntimeError(f"CVODE: {solution.message}")
        at_event = has_contact and solution.t_events is not None and len(solution.t_events) > 0
        found = np.isin(solution.t, ts[sample:])
        ys[sample : sample + found.sum()] = solution.y[found]
        sample += found.sum()
        if at_event:
            n_events += 1
            if n_events > MOST_EVENTS:
                raise RuntimeError(f"CVODE chatters at the contact surface: {n_events} events by {t:.3f} s")
            t, y = solution.t[-1], np.array(solution.y[-1])
            speed = _plain_crossing_rate(y, p) * p[CLEARANCE]
            memory = 0.0 if memory > 0 else max(speed, 1e-12)
    return ys


def radau(problem: Problem, ts, rtol: float, atol: float) -> np.ndarray:
    """SciPy's Radau: the integrator in Python, the right-hand side in numba."""
    from scipy.integrate import solve_ivp

    rate, p = rate_function(problem.kind), problem.parameters

    def right_side(t, y):
        out = np.empty(N_STATE)
        rate(y, 0.0, p, out)
        return out

    solution = solve_ivp(right_side, (ts[0], ts[-1]), problem.y0, method="Radau", t_eval=ts, rtol=rtol, atol=atol)
    if not solution.success:
        raise RuntimeError(f"Radau: {solution.message}")
    return solution.y.T


@njit
def _plain_crossing(y, p):
    return crossing(y, p)[0]


@njit
def _plain_crossing_rate(y, p):
    return crossing(y, p)[1]
