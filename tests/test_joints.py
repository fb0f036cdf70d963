"""Joints of every kind: their equations against differences, and what they leave free."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from joints import KINDS, pair

import spherejax as sj
from spherejax.model.system import compile_scene, flatten_system
from spherejax.motion.equations.body_motions import body_motions
from spherejax.motion.equations.constraints import constraint_set
from spherejax.motion.equations.programs import program_for
from spherejax.motion.start.assembly import described_state
from spherejax.physics.state import unpack

TIME = 0.37


def rows_of(system, t, y):
    """Everything that a joint's equations bring in."""
    found = constraint_set(system, t, body_motions(system, unpack(system.layout, y))).rows["joint"]
    return found.residual, jnp.concatenate(found.jacobians, 1), found.bias, found.rate_at_rest


@cache
def program_of(name):
    """The rows as a scalar program, evaluated without compiling anything; and a start off the constraints."""
    system = compile_scene(pair(KINDS[name].build())).system
    structure, theta = flatten_system(system)
    program = program_for(rows_of, structure)
    assert program.scalar is not None
    return lambda t, y: program.compute(theta, t, y), np.asarray(described_state(system)), system


def advanced(y, s, velocities):
    """Two bodies after a time s with constant velocities (displacement and rotation vector of each)."""
    moved = np.array(y)
    for i, v in enumerate(velocities.reshape(2, 6)):
        start = 7 * i
        moved[start : start + 3] += s * v[:3]
        angle = np.linalg.norm(v[3:]) * s
        axis = v[3:] / (np.linalg.norm(v[3:]) or 1.0)
        turn = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
        moved[start + 3 : start + 7] = product(turn, y[start + 3 : start + 7])
    return moved


def product(a, b):
    scalar = a[0] * b[0] - a[1:] @ b[1:]
    return np.concatenate([[scalar], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


H = 2e-3


def slope(function):
    """First derivative at 0 by differences of order 4."""
    return (8 * (function(H) - function(-H)) - (function(2 * H) - function(-2 * H))) / (12 * H)


def curvature(function):
    """Second derivative at 0 by differences of order 4."""
    near, far = function(H) + function(-H), function(2 * H) + function(-2 * H)
    return (16 * near - far - 30 * function(0.0)) / (12 * H * H)


@pytest.mark.parametrize("name", KINDS)
def test_rows_are_derivatives_of_the_residual(name):
    rows, y, _ = program_of(name)
    residual, jacobian, bias, rate_at_rest = rows(TIME, y)
    assert residual.shape == bias.shape == rate_at_rest.shape == (KINDS[name].n_rows,)
    nearly_met = ("distance at the start", "revolute", "revolute at a named point", "universal", "cylindrical",
                  "prismatic", "fixed", "rim", "rim with a collar", "same orientation", "parallel axes",
                  "perpendicular axes")  # fmt: skip
    assert np.abs(residual).max() > 1e-3 or name in nearly_met
    by_differences = np.stack([slope(lambda s, e=e: rows(TIME, advanced(y, s, e))[0]) for e in np.eye(12)], 1)
    assert jacobian == pytest.approx(by_differences, abs=1e-9)
    assert rate_at_rest == pytest.approx(slope(lambda s: rows(TIME + s, y)[0]), abs=1e-9)
    velocities = y[14:]
    gamma = -curvature(lambda s: rows(TIME + s, advanced(y, s, velocities))[0])
    assert np.abs(gamma).max() > 1e-3
    assert bias == pytest.approx(gamma, abs=1e-6)


@pytest.mark.parametrize("name", KINDS)
def test_number_of_rows_and_points(name):
    _, _, system = program_of(name)
    joint = system.joints["joint"]
    assert joint.n_rows == KINDS[name].n_rows == system.n_constraints
    assert joint.is_driven == ("driver" in name) == system.is_driven
    assert not joint.answers_with_force
    assert [np.shape(point) for point in joint.points] == [(3,), (3,)]


@pytest.mark.parametrize("name", KINDS)
def test_array_code_equals_the_scalar_program(name):
    rows, y, system = program_of(name)
    for scalar, array in zip(rows(TIME, y), jax.jit(rows_of)(system, TIME, y), strict=True):
        assert np.asarray(array) == pytest.approx(scalar, abs=1e-14)


@pytest.mark.parametrize("name", KINDS)
def test_degrees_of_freedom(name):
    report = sj.constraint_report(pair(KINDS[name].build()))
    assert report.n_equations == report.rank == KINDS[name].n_rows
    assert report.degrees_of_freedom == 12 - KINDS[name].n_rows
    assert report.redundant_joints == ()
    assert not report.is_singular
