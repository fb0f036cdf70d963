"""Models of `benchmarks/validation.py` recover known parameters from synthetic records of the same shape."""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))

from measured import furuta
from measured.comparing import predicted
from measured.records import Record, read, state_at


def test_a_missing_record_says_where_it_was_published(tmp_path):
    with pytest.raises(SystemExit, match=r"pendulum_single_1\.csv is missing.*arXiv 2205\.06231"):
        read(tmp_path, "pendulum_single_1.csv")


def test_the_state_at_the_beginning_of_a_record():
    times = np.arange(0.0, 1.0, 0.005)
    record = Record(3.0 + times, np.stack([np.sin(8 * times), np.cos(8 * times)], 1))
    values, rates = state_at(record, 3.0, 0.06, 5)
    assert np.allclose(values, [0.0, 1.0], atol=1e-6)
    assert np.allclose(rates, [8.0, 0.0], atol=1e-4)


COARSE = partial(furuta.two_moments, rate=1e-2)
MOMENTS = {"arm_moment": 0.01, "pendulum_moment": 0.001}


def test_the_furuta_pendulum_is_that_of_its_two_equations():
    """Lagrange's equations with the published moments of inertia, which no body has and spherejax refuses."""
    arm, other, rod = 0.001, 0.001, 0.00384
    mass, reach, center, gravity = 0.035, 0.245, 0.2105, 9.81
    coupling, swing = mass * reach * center, mass * center**2

    def rates(t, state):
        _, angle, arm_rate, rate = state
        s, c = np.sin(angle), np.cos(angle)
        masses = [[arm + other + mass * reach**2 + swing * s * s, -coupling * c], [-coupling * c, rod + swing]]
        dry = np.array([0.01, 0.001]) * np.tanh(np.array([arm_rate, rate]) / 1e-2)
        quick = [2 * swing * s * c * arm_rate * rate + coupling * s * rate**2, -swing * s * c * arm_rate**2]
        weight = np.array([0.0, mass * gravity * center * s])
        return [arm_rate, rate, *np.linalg.solve(masses, weight - dry - quick)]

    times = np.arange(0.0, 3.0, 0.05)
    angles = predicted(COARSE(**MOMENTS), times, furuta.FUNCTIONS, rtol=1e-9)
    reference = solve_ivp(rates, (0, 3), [0, np.pi / 6, 0, 0], "LSODA", times, rtol=1e-9, atol=1e-10)
    assert np.max(np.abs(angles - reference.y[:2].T)) < 1e-5
