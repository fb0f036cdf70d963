"""Wear with a motion that follows: against a solution of its own, conservation, profiles, errors, bad input."""

import importlib
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import spherejax as sj
from spherejax.physics.laws.depth import harmonics
from spherejax.physics.laws.wear import foundation_depth
from spherejax.studies.wear.deposit import Maps
from spherejax.studies.wear.gap import fitted, misfit
from spherejax.studies.wear.sphere import cell_solid_angle, centers
from spherejax.studies.wear.study import contact_surface, cycles_of

module = importlib.import_module("spherejax.studies.wear.wear_in")  # the package has the function by this name

C, R, LOAD, RATE = 1e-4, 1e-2, 200.0, 30.0
K, FOUNDATION, SPRING, STIFFNESS = 1e-13, 1e12, 2e6, 1.5e11
TURN, SETTLED = 2 * np.pi / RATE, 0.1
TS = np.linspace(0.0, SETTLED + TURN, 21)
OPTIONS = {"k_socket": K, "k_ball": 0.0, "foundation": FOUNDATION, "window": (SETTLED, SETTLED + TURN)}
CYCLES, CELLS = 1500.0, 48


def indentation(load):
    return (load / STIFFNESS) ** (2 / 3)


def scene(spring=SPRING, **depths):
    """A ball that turns about y, and is pressed on the bottom of its socket by a spring, which wear relaxes."""
    start = -C - indentation(LOAD)
    ball = sj.Body(
        1.0, (1e-3,) * 3, position=(0, 0, start), angular_velocity=(0, RATE, 0), points={"center": (0, 0, 0)}
    )
    cup = sj.Body(1.0, (1e-3,) * 3, points={"center": (0, 0, 0)})
    law = sj.laws.HuntCrossleyDissipation(dissipation=30.0, stiffness=STIFFNESS)
    dry = sj.Dry(C, socket_radius=R, normal=law, **depths)
    joints = {
        "held": sj.Fixed(("ground", "cup"), point=(0, 0, 0)),
        "joint": sj.Spherical("cup.center", "ball.center", dry, starts_concentric=False),
    }
    pull = sj.SpringDamper(("ground.anchor", "ball.center"), spring, 300.0, 1.0 + start - LOAD / spring)
    ground = {"anchor": (0, 0, -1.0)}
    return sj.Scene({"ball": ball, "cup": cup}, joints, {"spring": pull}, gravity=(0, 0, 0), ground_points=ground)


def wear_in(**options):
    return sj.studies.wear_in(scene(), "joint", TS, **{**OPTIONS, "cells": CELLS, "rtol": 1e-8, **options})


@pytest.fixture(scope="module")
def worn():
    return wear_in(cycles=CYCLES)


@pytest.fixture(scope="module")
def cycle():
    """The first cycle."""
    return first_cycle().parts[0]


def first_cycle(cells=CELLS):
    run = sj.simulate(scene(), TS, rtol=1e-8)
    return cycles_of(run, contact_surface(run, "joint", None), (K, 0.0), OPTIONS["window"], FOUNDATION, cells)


def near(value, rel):
    return pytest.approx(value, rel=rel, abs=0.0)


class Independent:
    """The depth of the socket on a polar grid about the load, in NumPy, with SciPy's steps in the number of cycles.

    Winkler's pressure on the worn socket carries the load; the spring is relaxed by how much farther the ball goes.
    """

    def __init__(self):
        angle, share = np.polynomial.legendre.leggauss(60)
        turn, part = np.polynomial.legendre.leggauss(10)
        theta, phi = np.meshgrid(0.5 * (angle + 1), np.pi / 4 * (turn + 1), indexing="ij")
        self.areas = 4 * R**2 * np.sin(theta) * (0.5 * share[:, None] * np.pi / 4 * part[None])
        self.cos = np.cos(theta)
        self.u = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -self.cos], -1)

    def approach(self, depth, load):
        def missing(s):
            return (FOUNDATION * np.maximum(0, s * self.cos - C - depth) * self.cos * self.areas).sum() - load

        return brentq(missing, 0.5 * C, 4 * C, xtol=1e-16)

    def farther(self, depth, load):
        return self.approach(depth, load) - self.approach(0.0, load)

    def load(self, depth):
        def missing(load):
            return LOAD - SPRING * (self.farther(depth, load) + indentation(load) - indentation(LOAD)) - load

        return brentq(missing, 1.0, LOAD + 1)

    def rate(self, _, flat):
        depth = flat.reshape(self.cos.shape)
        load = self.load(depth)
        pressure = FOUNDATION * np.maximum(0, self.approach(depth, load) * self.cos - C - depth)
        n, spin = np.array([0, 0, -1.0]), np.array([0, RATE, 0])
        e = (C + self.farther(depth, load) + indentation(load)) * n
        v = np.cross(spin, R * self.u - e)
        v = v - np.sum(v * self.u, -1, keepdims=True) * self.u
        return (K * pressure * np.linalg.norm(v, axis=-1) * TURN).ravel()

    def depths(self, cycles):
        start = np.zeros(self.cos.size)
        found = solve_ivp(self.rate, (0, cycles[-1]), start, method="RK23", rtol=1e-4, atol=1e-9, t_eval=cycles)
        return [y.reshape(self.cos.shape) for y in found.y.T]


# Against another solution ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_load_that_wear_relaxes_follows_an_independent_solution(worn):
    """The load falls by a fifth; without a motion that follows it stays."""
    other = Independent()
    depths = other.depths(worn.cycles)
    volumes = np.array([(h * other.areas).sum() for h in depths])
    loads = np.array([other.load(h) for h in depths])
    np.testing.assert_allclose(worn.volumes("socket")[1:], volumes[1:], rtol=5e-3)
    np.testing.assert_allclose([block.impulse / TURN for block in worn.blocks], loads, rtol=2e-3)
    assert loads[-1] < 0.82 * LOAD
    # The ball of the last run lies where the other solution has it.
    e = np.asarray(worn.run.eccentricity("joint")[-1])
    expected = C + other.farther(depths[-1], loads[-1]) + indentation(loads[-1])
    np.testing.assert_allclose(e, [0, 0, -expected], atol=5e-3 * C)
    assert worn.deepest("socket")[-1] == near(max(h.max() for h in depths), 0.03)


@pytest.mark.slow
def test_all_that_is_rubbed_off_is_on_the_maps(worn):
    state = worn.wear.states[-1]
    area = R**2 * cell_solid_angle(CELLS)
    assert float(jnp.sum(state.depth.socket)) * area == near(state.volume[0], 1e-9)
    assert state.volume[1] == 0.0
    assert worn.volumes("socket")[-1] == near(state.volume[0], 1e-9)
    assert np.all(np.diff(worn.volumes("socket")) > 0)


@pytest.mark.slow
def test_maps_that_lose_something_are_an_error(worn, monkeypatch):
    kept = worn.wear.states[-1]
    module._require_kept(_cycle(worn), kept)
    with pytest.raises(sj.SimulationError, match="not conserved"):
        module._require_kept(_cycle(worn), kept._replace(volume=(kept.volume[0] * (1 + 2e-9), 0.0)))


def _cycle(worn):
    return first_cycle(worn.wear.cells)


def test_errors_of_blocks_are_held(worn):
    assert len(worn.blocks) > 3
    assert 0 < worn.error.max() <= 0.02
    assert worn.misfit.max() < 0.01 * C


@pytest.mark.slow
def test_a_smaller_tolerance_takes_more_blocks_to_the_same_volume(worn):
    finer = wear_in(cycles=CYCLES, tolerance=0.004)
    assert len(finer.blocks) > len(worn.blocks)
    assert worn.volumes("socket")[-1] == near(finer.volumes("socket")[-1], 3e-3)


@pytest.mark.slow
def test_without_a_spring_that_gives_the_volume_is_that_of_the_unworn_motion():
    soft = scene(spring=1e3)
    run = sj.simulate(soft, TS, rtol=1e-8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sj.errors.WearWarning)
        alone = sj.wear(run, "joint", cycles=CYCLES, cells=CELLS, **OPTIONS)
    follows = sj.studies.wear_in(soft, "joint", TS, cycles=CYCLES, cells=CELLS, rtol=1e-8, **OPTIONS)
    assert follows.volumes("socket")[-1] == near(alone.volumes("socket")[-1], 0.01)
    assert follows.run.penetration("joint")[-1] == near(float(run.penetration("joint")[-1]), 0.05)


# Profiles -------------------------------------------------------------------------------------------------------------


def test_a_uniform_wear_is_a_uniform_profile(cycle):
    depth = 2e-5
    maps = Maps(jnp.full(CELLS**2, depth), jnp.zeros(CELLS**2))
    told = cycle.rubbed(maps)[1]
    profiles = fitted(cycle, maps, told, 4)
    assert profiles.ball is None
    # On a larger socket the same load presses the ball in farther: its patch is smaller.
    pressed = [float(foundation_depth(LOAD, c, R, FOUNDATION)) for c in (C + depth, C)]
    assert profiles.socket[0] == near(depth + pressed[0] - pressed[1], 5e-3)
    assert np.abs(profiles.socket[1:]).max() < 1e-3 * depth
    assert misfit(cycle, told, profiles) < 1e-3 * depth


@pytest.mark.slow
def test_a_run_on_a_shaped_joint_wears_from_there(worn):
    """The last run again, by `sj.wear`, which begins on the surfaces of its joint."""
    again = sj.wear(worn.run, "joint", cells=CELLS, **OPTIONS)
    assert again.checks.slid == near(worn.blocks[-1].slid, 1e-3)
    # The profile is smoother than the map, and the patch on it another; the work is the same but for its width.
    assert again.volume_per_cycle["socket"] == near(float(worn.wear.states[-1].rate.volume[0]), 0.02)


@pytest.mark.slow
def test_what_it_returns(worn, tmp_path):
    text = str(worn)
    assert "motion of the worn joint: impulse of the normal force 41.8" in text
    assert "profiles of degree 8, off by" in text
    profile = worn.profile("socket")
    assert profile is not None
    assert worn.profile("ball") is None
    down = harmonics(np.array([0, 0, -1.0]), 8) @ profile.coefficients
    assert down == near(worn.wear.states[-1].rate.approach, 0.02)
    assert -1 < worn.lost_volume("socket") < 0.2
    data = worn.to_xarray()
    assert data["socket_profile"].shape == (len(worn.cycles), 81)
    assert data["impulse"].attrs["units"] == "N s"
    worn.save(tmp_path / "worn.nc")
    model = worn.scene.joints["joint"].model
    np.testing.assert_array_equal(model.socket_depth.coefficients, profile.coefficients)
    assert worn.figure().axes


@pytest.mark.slow
def test_both_sides_wear():
    found = wear_in(cycles=400.0, k_ball=3e-14, cells=48, tolerance=0.05)
    assert found.succeeded
    area = R**2 * cell_solid_angle(48)
    for side, volume in zip(("socket", "ball"), found.wear.states[-1].volume, strict=True):
        assert found.depth(side).sum() * area == near(volume, 1e-9)
    assert found.volumes("socket")[-1] == near(found.volumes("ball")[-1] * K / 3e-14, 1e-9)
    # The ball wears in a ring about its axis, y.
    deepest = centers(48).reshape(-1, 3)[found.depth("ball").argmax()]
    assert abs(deepest[1]) < 0.1
    assert found.misfit[-1] < 0.1 * found.wear.states[-1].rate.approach


# What cannot be ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"degree": 0}, "degree"),
        ({"degree": 30}, "degree = 30 must be at most 24"),
        ({"tolerance": 0.0}, "tolerance = 0 must be positive"),
        ({"tolerance": "fine"}, "must be a number"),
        ({"k_socket": -1.0}, "k_socket = -1"),
        ({"cycles": 0.0}, "cycles = 0 must be positive"),
        ({"window": (0.0, 9.0)}, "must lie within the run"),
    ],
)
def test_wrong_numbers_are_answered(options, said):
    with pytest.raises(sj.SceneError, match=said):
        wear_in(**{"cycles": 10.0, **options})


def test_a_ball_that_only_falls_wears_nothing_and_says_how_far_it_is():
    """Depths are rounding then, and blocks must not be made ever shorter for their errors."""
    ball = sj.Body(0.2, (1e-5,) * 3, points={"center": (0, 0, 0)})
    joint = sj.Spherical("ground.cup", "ball.center", sj.Dry(C, normal=sj.Hertz()))
    falling = sj.Scene({"ball": ball}, {"cup": joint}, ground_points={"cup": (0, 0, 0)})
    lines = []
    with pytest.warns(sj.errors.WearWarning, match="Ask for more cells"):
        found = sj.studies.wear_in(
            falling, "cup", np.linspace(0, 8e-3, 3), k_socket=K, k_ball=0.0, cycles=10.0, cells=16, degree=1,
            progress=lines.append,
        )  # fmt: skip
    assert found.cycles[-1] == 10.0
    assert np.max(found.volumes("socket")) < 1e-20
    assert lines[0] == "the first cycle"
    assert lines[1] == "0 of 10 cycles, a block of 2.5"


def test_wrong_joints_are_answered():
    with pytest.raises(sj.SceneError, match="did you mean 'joint'"):
        sj.studies.wear_in(scene(), "joind", TS, cycles=1.0, **OPTIONS)
    with pytest.raises(sj.SceneError, match="those of Dry"):
        sj.studies.wear_in(scene(), "held", TS, cycles=1.0, **OPTIONS)
    with pytest.raises(sj.SceneError, match="takes a scene"):
        sj.studies.wear_in("hip", "joint", TS, cycles=1.0, **OPTIONS)


@pytest.mark.slow
def test_a_study_that_cannot_go_on_says_why(monkeypatch):
    monkeypatch.setattr(module, "MOST_TRIES", 1)
    with pytest.warns(sj.errors.WearWarning, match="after 1 blocks .* larger tolerance="):
        found = wear_in(cycles=CYCLES)
    assert not found.succeeded
    assert found.cycles[-1] < CYCLES
