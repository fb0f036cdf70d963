"""Models of `benchmarks/validation.py` recover known parameters from synthetic records of the same shape."""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

sys.path.append(str(Path(__file__).parent.parent / "benchmarks"))

from measured import driven, emps, furuta, pendulum
from measured.comparing import least_squares_by_differences, predicted
from measured.records import Record, read, state_at

import spherejax as sj


def test_a_missing_record_says_where_it_was_published(tmp_path):
    with pytest.raises(SystemExit, match=r"pendulum_single_1\.csv is missing.*arXiv 2205\.06231"):
        read(tmp_path, "pendulum_single_1.csv")


def test_the_state_at_the_beginning_of_a_record():
    times = np.arange(0.0, 1.0, 0.005)
    record = Record(3.0 + times, np.stack([np.sin(8 * times), np.cos(8 * times)], 1))
    values, rates = state_at(record, 3.0, 0.06, 5)
    assert np.allclose(values, [0.0, 1.0], atol=1e-6)
    assert np.allclose(rates, [8.0, 0.0], atol=1e-4)


def test_a_sampled_reference_becomes_few_speeds():
    times = np.arange(0.0, 2.0, 1e-3)
    knots, speeds = np.array([0.0, 0.1, 0.7, 0.85, 1.2, 1.999]), np.array([0.0, 0.08, 0.08, 0.0, 0.0, -0.3])
    grid = np.union1d(times, knots)
    speed = np.interp(grid, knots, speeds)
    way = 0.01 + np.concatenate([[0.0], np.cumsum(np.diff(grid) * (speed[1:] + speed[:-1]) / 2)])
    positions = np.interp(times, grid, way)
    instants, values, begin, again = emps.reference_of(times, positions)
    assert np.max(np.abs(again - positions)) < 1e-6
    assert len(instants) <= len(knots) + 1
    assert np.max(np.abs(np.interp(times, instants, values) - np.interp(times, knots, speeds))) < 1e-3
    assert abs(begin - 0.01) < 1e-6


def test_the_friction_of_a_swinging_arm_is_recovered():
    times = np.arange(0.0, 4.0, 0.005)
    truth = {"moment": 2.5e-4, "square": 7e-6}
    scene = pendulum.single(1.6, 0.3, inertia=4.54e-4, tilt=1e-3, **truth)
    values = predicted(scene, times, {"angle": pendulum.arm_angle})
    fit, _ = pendulum.fit_decays({1: Record(5.0 + times, values)}, {"moment": 1e-4, "square": 2e-6})
    assert fit.succeeded
    for name, value in truth.items():
        assert abs(fit.estimates[name] - value) < 0.5 * fit.standard_deviations[name]


COARSE = partial(furuta.two_moments, rate=1e-2)
MOMENTS = {"arm_moment": 0.01, "pendulum_moment": 0.001}


def test_the_moments_of_a_furuta_pendulum_are_recovered():
    times = np.arange(0.0, 5.0, 0.05)
    angles = predicted(COARSE(**MOMENTS), times, furuta.FUNCTIONS, rtol=1e-7)
    record = furuta.measured_of(times, angles, noise=0.02)
    fit = sj.fit(COARSE, furuta.FIRST_GUESS, record, horizon=sj.studies.Whole(), rtol=1e-7, progress=False)
    assert fit.succeeded
    for name, value in MOMENTS.items():
        assert abs(fit.estimates[name] / value - 1) < 1e-3


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


def test_the_drive_follows_its_reference_and_shows_its_friction():
    """At a constant speed the voltage is that of both resistances, and the position lags by what the loops need."""
    reference = np.array([0.0, 0.1, 1.0]), np.array([0.0, 0.1, 0.1]), 0.0
    scene = emps.drive(reference, 0.0, 0.0, mass=95.0, viscous=200.0, coulomb=20.0, offset=-3.0)
    position, voltage = predicted(scene, np.array([0.0, 0.8]), emps.FUNCTIONS, rtol=1e-8)[1]
    force = 200.0 * 0.1 + 20.0 - 3.0
    assert abs(voltage * emps.FORCE / force - 1) < 1e-6
    lag = (voltage / emps.SPEED_GAIN + 0.1) / emps.POSITION_GAIN
    assert abs(position - (0.1 * 0.8 - 0.005 - lag)) < 1e-8


@pytest.mark.slow
def test_a_table_of_friction_against_speed_is_felt_in_the_drive():
    """Beside the dry friction, the table's value at the speed, in both directions."""
    for direction in (1.0, -1.0):
        reference = np.array([0.0, 0.1, 1.0]), direction * np.array([0.0, 0.083, 0.083]), 0.0
        table = np.array([5.0, 10.0, 18.0, 27.0])
        scene = emps.drive(reference, 0.0, 0.0, mass=95.0, coulomb=20.0, by_speed=table)
        _, voltage = predicted(scene, np.array([0.0, 0.8]), emps.FUNCTIONS, rtol=1e-8)[1]
        assert abs(voltage * emps.FORCE / (20.0 + 18.0) - direction) < 1e-6


@pytest.mark.slow
def test_the_driven_double_pendulum_is_that_of_its_three_equations():
    """Lagrange's equations of both links and of the elbow's rotor behind its gear, the shoulder's by its ratio."""
    numbers = driven.PUBLISHED
    first, second, rotor = (numbers[name] for name in ("first_inertia", "second_inertia", "rotor"))
    (upper, lower), (_, center), small = driven.MASSES, driven.CENTERS, driven.ROTOR_MASS
    coupling, weight = lower * 0.3 * center, 9.81 * lower * center

    def rates(t, state):
        _, elbow, turn, first_rate, elbow_rate, turn_rate = state
        s, c = np.sin(elbow), np.cos(elbow)
        whole = first + second + (lower + small) * 0.3**2 + 2 * coupling * c + 37 * rotor
        masses = [[whole, second + coupling * c, rotor], [second + coupling * c, second, 0.0], [rotor, 0.0, rotor]]
        quick = [-coupling * s * (2 * first_rate + elbow_rate) * elbow_rate, coupling * s * first_rate**2, 0.0]
        below = weight * np.sin(state[0] + elbow)
        teeth = driven.TEETH * (elbow + turn / 6) + driven.TEETH_DAMPING * (elbow_rate + turn_rate / 6)
        pull = [9.81 * (upper + lower + small) * 0.3 * np.sin(state[0]) + below, below + teeth, teeth / 6]
        speeds = np.array([first_rate, elbow_rate, 0.0])
        friction = np.array([0.093, 0.078, 0.0]) * np.tanh(speeds / driven.RATE) + 0.001 * speeds
        return [first_rate, elbow_rate, turn_rate, *np.linalg.solve(masses, -np.array(pull) - friction - quick)]

    times = np.arange(0.0, 0.8, 0.02)
    angles = predicted(driven.driven((1.4, 1.5), (0.0, 0.5), **numbers), times, driven.FUNCTIONS, rtol=1e-7)
    start = [1.4, 1.5, -6 * 1.5, 0.0, 0.5, -6 * 0.5]
    reference = solve_ivp(rates, (0, 0.8), start, "LSODA", times, rtol=1e-9, atol=1e-10)
    assert np.max(np.abs(angles - reference.y[:2].T)) < 2e-5


@pytest.mark.slow
def test_least_squares_by_differences_counts_its_runs_and_finds_the_friction():
    times = np.arange(0.0, 2.0, 0.01)

    def build(viscous):
        return pendulum.single(1.6, 0.3, viscous=viscous)

    functions = {"angle": pendulum.arm_angle}
    values = predicted(build(2e-4), times, functions)
    search = least_squares_by_differences(build, {"viscous": 1e-4}, times, values, functions, diff_step=1e-4)
    assert abs(search.numbers["viscous"] / 2e-4 - 1) < 1e-3
    assert search.cost < 1e-6
    assert search.runs > 5
