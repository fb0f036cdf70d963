"""Runs that go on: cut in pieces they are the run that was not, within contacts too, with their derivatives."""

from dataclasses import replace
from typing import Any

import cases
import controlling
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_film_memory import scene as film_scene
from test_rubber import driven

import spherejax as sj

RAIL = {"rail": sj.Prismatic(("ground", "block"), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))}
MASS = 2.0


def bouncing(friction, push=0.0):
    """A ball that strikes its socket obliquely, so that friction spins it; with a push it stays there."""
    model = sj.Dry(clearance=1e-4, normal=sj.LankaraniNikravesh(restitution=0.9), friction=friction)
    scene = cases.ball_in_socket(model, velocity=(0.05, 0.02, 0.0))
    forces = {"push": sj.AppliedWrench("ball", force=(0.0, 0.0, -push))} if push else {}
    beside = {"ball": replace(scene.bodies["ball"], position=(0.0, 0.0, 5e-5))}
    return sj.Scene(beside, scene.joints, forces, gravity=(0, 0, 0), ground_points=scene.ground_points)


def block(stiffness=8.0, push=0.0, speed=1.0):
    """A mass on a spring along a rail, and an actuator that pushes it."""
    body = sj.Body(MASS, (1.0, 1.0, 1.0), velocity=(speed, 0.0, 0.0))
    along = sj.Travel(("ground", "block"), (1.0, 0.0, 0.0))
    forces = {"spring": sj.PID(along, 0.0, stiffness), "motor": sj.Actuator(along, push)}
    return sj.Scene({"block": body}, RAIL, forces, gravity=(0.0, 0.0, 0.0))


def block_at(t, x, v, stiffness, push):
    """Its place and velocity after a time, in closed form."""
    w, middle = np.sqrt(stiffness / MASS), push / stiffness
    return (
        middle + (x - middle) * np.cos(w * t) + v / w * np.sin(w * t),
        -(x - middle) * w * np.sin(w * t) + v * np.cos(w * t),
    )


def cut(scene, ts, n=10, **options):
    """The states of a run in n pieces."""
    k = (len(ts) - 1) // n
    run = sj.simulate(scene, ts[: k + 1], **options)
    ys = [run.ys]
    for i in range(1, n):
        run = sj.continue_from(run, ts[i * k : (i + 1) * k + 1])
        np.testing.assert_allclose(run.ys[0], ys[-1][-1], rtol=1e-13, atol=1e-15)  # corrected once more
        ys.append(run.ys[1:])
    assert bool(run.succeeded)
    return np.concatenate(ys), run


SCENES = {
    "pendulum": (cases.pendulum, 1.0),
    "bouncing ball": (lambda: bouncing(sj.Threlfall(mu=0.1, v1=1e-3)), 8e-3),
    "bristles": (lambda: bouncing(sj.LuGre(), 20.0), 4e-3),
    "PID": (lambda: controlling.motor(sj.PID(controlling.ROTOR, 1.5, **controlling.GAINS)), 0.5),
    "sampled PID": (lambda: controlling.sampled_motor(0.01), 0.5),
    "film with memory": (lambda: film_scene(sj.laws.FullFilm()), 0.01),
    "rubber": (
        lambda: driven(
            sj.Bushing(
                law=sj.laws.VectorElastomer(2e5, 0.0),
                branches=sj.laws.Maxwell(1e5, 0.1),
                friction=sj.laws.Berg(40.0, 1e-4),
            ),
            sj.functions.Sine(3e-4, 5.0),
        ),
        0.5,
    ),
}


@pytest.mark.parametrize("name", SCENES)
def test_a_run_in_ten_pieces_is_the_whole(name):
    build, t_end = SCENES[name]
    scene, ts = build(), np.linspace(0.0, t_end, 51)
    whole = sj.simulate(scene, ts, rtol=1e-10)
    ys, last = cut(scene, ts, rtol=1e-10)
    allowed = 1e-9 + 1e-8 * np.max(np.abs(whole.ys), axis=0)
    assert np.all(np.abs(ys - whole.ys) <= allowed)
    assert last.ts[0] == ts[45]
    assert whole.stats.n_steps > 10


def test_a_contact_that_is_cut_goes_on_with_its_impact_speed():
    scene = bouncing(sj.Threlfall(mu=0.1, v1=1e-3))
    ts = np.linspace(0.0, 8e-3, 2001)
    whole = sj.simulate(scene, ts, rtol=1e-10)
    speed = np.asarray(whole.memory("joint")["onset_rate"])
    (within,) = np.flatnonzero(speed)[:1] + 1  # a step of the sampling behind the first onset
    assert speed[within] == speed[within + 1] > 0
    first = sj.simulate(scene, ts[: within + 1], rtol=1e-10)
    second = sj.continue_from(first, ts[within:])
    np.testing.assert_allclose(second.memory("joint")["onset_rate"][0], speed[within], rtol=1e-9)
    np.testing.assert_allclose(second.position("ball")[-1], whole.position("ball")[-1], atol=1e-11)
    np.testing.assert_allclose(second.mechanical_energy[-1], whole.mechanical_energy[-1], rtol=1e-8)
    # Its error is that of the second piece: repeated, it begins with the same memory.
    assert second.error("position.ball").max() < 1e-10


WAYS = {"lanes": {}, "diffrax": {"solver": diffrax.Kvaerno5()}, "array code": {"scalar": False}}


@pytest.mark.parametrize("way", [*list(WAYS)[:2], pytest.param("array code", marks=pytest.mark.slow)])
def test_other_numbers_from_the_seam_on(way):
    options = {"rtol": 1e-10, **WAYS[way]}
    first = sj.simulate(block(8.0, 0.0), np.array([0.0, 0.6]), **options)
    second = sj.continue_from(first, np.array([0.8, 1.0]), block(3.0, 5.0))
    x, v = block_at(0.6, 0.0, 1.0, 8.0, 0.0)
    expected = [x, *(block_at(t, x, v, 3.0, 5.0)[0] for t in (0.2, 0.4))]
    np.testing.assert_allclose(second.ts, [0.6, 0.8, 1.0])
    np.testing.assert_allclose(second.position("block")[:, 0], expected, atol=1e-8)
    assert second.settings == first.settings
    assert second.scalar == first.scalar


def test_many_runs_go_on_side_by_side_and_in_a_scan():
    ts = np.linspace(0.0, 0.5, 6)
    stiffnesses = jnp.array([3.0, 8.0])

    def in_pieces(k):
        return sj.continue_from(sj.simulate(block(k), ts), ts + 0.5).position("block")[-1, 0]

    expected = [block_at(1.0, 0.0, 1.0, k, 0.0)[0] for k in stiffnesses]
    np.testing.assert_allclose(jax.vmap(in_pieces)(stiffnesses), expected, atol=1e-7)

    first = sj.simulate(block(8.0), ts)

    def piece(state, _):
        run = sj.continue_from(state, state.t + ts)
        return run.end, run.position("block")[-1, 0]

    end, places = jax.jit(lambda state: jax.lax.scan(piece, state, length=2))(first.end)
    np.testing.assert_allclose(places, [block_at(t, 0.0, 1.0, 8.0, 0.0)[0] for t in (1.0, 1.5)], atol=1e-7)
    np.testing.assert_allclose(end.t, 1.5)
    np.testing.assert_allclose(end.position("block")[0], places[-1])
    with pytest.raises(sj.SceneError, match=r"jax\.vmap"):
        sj.continue_from(jax.vmap(lambda k: sj.simulate(block(k), ts))(stiffnesses), ts + 0.5)


def test_a_clearance_that_shrinks_around_a_ball_begins_a_contact():
    """The ball rests beyond the new surface: pressed in by a static load, it leaves with the energy that is stored."""
    first = sj.simulate(cases.ball_in_socket(sj.Dry(1e-4), velocity=(0.05, 0.02, 0.0)), np.array([0.0, 1.5e-3]))
    distance = float(np.linalg.norm(first.eccentricity("joint")[-1]))
    model = sj.Dry(distance - 1e-7, normal=sj.Hertz())
    scene = cases.ball_in_socket(model)
    second = sj.continue_from(first, np.array([1.5e-3, 2e-3]), scene)
    assert second.memory("joint")["onset_rate"][0] > 0
    np.testing.assert_allclose(second.mechanical_energy[-1], second.mechanical_energy[0], rtol=1e-6)
    assert second.mechanical_energy[0] > first.mechanical_energy[-1]


def same_with(**parts):
    """The block with other parts."""
    scene = block()
    given = {"joints": scene.joints, "forces": scene.forces, **parts}
    return sj.Scene(scene.bodies, **given, gravity=(0.0, 0.0, 0.0))


def test_what_does_not_fit_is_named():
    run = sj.simulate(block(), np.array([0.0, 0.9]))
    forces = block().forces
    other = sj.PID(sj.Travel(("ground", "block"), (1.0, 0.0, 0.0)), 0.0, 8.0, integral=1.0)
    tilted = sj.Prismatic(("ground", "block"), (0.0, 0.0, 0.0), (1.0, 1e-3, 0.0))
    fewer = same_with(forces={"spring": forces["spring"]})
    remembering = same_with(forces={**forces, "spring": other})
    elsewhere = same_with(joints={"rail": tilted})
    later = np.array([0.9, 1.0])
    no_run: Any = block()
    no_scene: Any = {"motor": 1.0}
    with pytest.raises(sj.SceneError, match="the run has body 'block'"):
        sj.continue_from(run, later, cases.pendulum())
    with pytest.raises(sj.SceneError, match="the run has force element 'motor'"):
        sj.continue_from(run, later, fewer)
    with pytest.raises(sj.SceneError, match="'spring' remembers nothing in the run and integral in the scene"):
        sj.continue_from(run, later, remembering)
    with pytest.raises(sj.SceneError, match="joint 'rail' would jump by"):
        sj.continue_from(run, later, elsewhere)
    with pytest.raises(sj.SceneError, match="before the end of the run"):
        sj.continue_from(run, np.array([0.05, 1.0]))
    with pytest.raises(sj.SceneError, match="a Scene is no state of a motion"):
        sj.continue_from(no_run, later)
    with pytest.raises(sj.SceneError, match="is no scene"):
        sj.continue_from(run, later, no_scene)


def test_a_failed_run_does_not_go_on():
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        failed = sj.simulate(block(), np.array([0.0, 10.0]), max_steps=5)
    with pytest.raises(sj.SimulationError, match="max_steps"):
        sj.continue_from(failed, np.array([10.0, 11.0]))

    def traced(k):
        run = sj.simulate(block(k), np.array([0.0, 10.0]), max_steps=5)
        return sj.continue_from(run, np.array([10.0, 11.0]))

    found = jax.jit(traced)(8.0)
    assert found.status is sj.Status.TOO_MANY_STEPS
    assert np.all(np.isnan(found.ys))


def test_times_that_are_traced_begin_with_the_end():
    run = sj.simulate(block(), np.array([0.0, 0.5]))
    later = jax.jit(lambda ts: sj.continue_from(run, ts).ended)
    assert later(jnp.array([0.5, 0.6])) == sj.Status.SUCCEEDED
    assert later(jnp.array([0.4, 0.6])) == sj.Status.BAD_VALUE


@pytest.mark.slow  # beside it: the example of the page `howto/go_on.md`
def test_derivatives_pass_the_seam():
    ts = jnp.array([0.0, 0.6, 1.0])

    def in_pieces(k, push, speed):
        first = sj.simulate(block(k, 0.0, speed), ts[:2], rtol=1e-9)
        second = sj.continue_from(first, ts[1:], block(k, push, speed))
        return second.position("block")[-1, 0]

    def exact(k, push, speed):
        return block_at(0.4, *block_at(0.6, 0.0, speed, k, 0.0), k, push)[0]

    at = (8.0, 5.0, 1.0)
    differences = [(exact(*np.add(at, step)) - exact(*np.subtract(at, step))) / 2e-5 for step in 1e-5 * np.eye(3)]
    reverse = jax.jit(jax.grad(in_pieces, (0, 1, 2)))(*at)
    np.testing.assert_allclose(reverse, differences, rtol=1e-6)
    _, forward = jax.jvp(in_pieces, at, (0.0, 0.0, 1.0))
    np.testing.assert_allclose(forward, differences[2], rtol=1e-6)


@pytest.mark.slow
def test_derivatives_pass_a_seam_within_a_contact():
    ts = np.array([0.0, 1.88e-3, 3e-3])

    def whole(speed, e):
        return sj.simulate(struck(speed, e), ts, rtol=1e-9).velocity("ball")[-1, :2].sum()

    def in_pieces(speed, e):
        run = sj.simulate(struck(speed, e), ts[:2], rtol=1e-9)
        return sj.continue_from(run, ts[1:]).velocity("ball")[-1, :2].sum()

    def struck(speed, e):
        model = sj.Dry(1e-4, normal=sj.HuntCrossley(restitution=e))
        return cases.ball_in_socket(model, velocity=(speed, 0.02, 0.0))

    assert sj.simulate(struck(0.05, 0.9), ts).memory("joint")["onset_rate"][1] > 0
    expected = jax.grad(whole, (0, 1))(0.05, 0.9)
    np.testing.assert_allclose(jax.grad(in_pieces, (0, 1))(0.05, 0.9), expected, rtol=1e-5)


def test_other_numbers_of_a_scene_without_joints_are_gone_on_with_under_jit():
    """There is no joint that could jump, and the time of the seam is no number yet: it was asked for all the same."""

    def end(mass):
        def fallen(mass):
            force = sj.AppliedWrench("ball", lambda t, motions: jnp.array([1.0, 0.0, 0.0]))
            return sj.Scene({"ball": sj.Body(mass, (1.0,) * 3)}, forces={"push": force}, gravity=(0.0, 0.0, 0.0))

        first = sj.simulate(fallen(mass), jnp.array([0.0, 1.0]))
        return sj.continue_from(first, jnp.array([1.0, 2.0]), scene=fallen(2 * mass)).position("ball")[-1, 0]

    # 1/2 t^2 / m, then on at the speed t / m with half of the acceleration.
    np.testing.assert_allclose(jax.jit(end)(2.0), 0.25 + 0.5 + 0.125, rtol=1e-9)
