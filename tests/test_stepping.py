"""A mechanism step by step: inputs are held during a step, and a rollout is one program with derivatives."""

from typing import Any

import cases
import controlling
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_continuation import MASS, block, block_at

import spherejax as sj

PUSHES = np.array([2.0, 0.0, -1.0])


def expected_places(pushes, stiffness=8.0, speed=1.0, dt=0.1):
    """Of the block after each step, in closed form."""
    x, v, places = 0.0, speed, []
    for push in pushes:
        x, v = block_at(dt, x, v, stiffness, push)
        places.append(x)
    return np.array(places)


def rollout(state, pushes):
    def step(state, push):
        state = sj.advance(state, 0.1, {"motor.offset": push})
        return state, state.position("block")[0]

    return jax.lax.scan(step, state, pushes)


def test_inputs_are_held_during_a_step():
    state, places = sj.start(block()), []
    for push in PUSHES:
        state = sj.advance(state, 0.1, {"motor.offset": push})
        places.append(state.position("block")[0])
    np.testing.assert_allclose(places, expected_places(PUSHES), atol=1e-9)
    np.testing.assert_allclose(state.t, 0.3)
    assert repr(state) == "State of block at t = 0.3 s"
    # The inputs were those of the steps: a run that goes on has the scene's own numbers.
    run = sj.continue_from(state, np.array([0.3, 0.5]))
    x, v = float(state.position("block")[0]), float(state.velocity("block")[0])
    np.testing.assert_allclose(run.position("block")[-1, 0], block_at(0.2, x, v, 8.0, 0.0)[0], atol=1e-8)


def test_a_rollout_is_one_program_for_many_states():
    end, places = jax.jit(rollout)(sj.start(block()), PUSHES)
    np.testing.assert_allclose(places, expected_places(PUSHES), atol=1e-9)
    assert bool(end.succeeded)
    speeds = jnp.array([1.0, 2.0])
    states = jax.vmap(lambda speed: sj.start(block(speed=speed)))(speeds)
    assert repr(states) == "2 states of block"
    kinetic = jax.vmap(lambda state: state.observation.kinetic_energy)(states)
    np.testing.assert_allclose(kinetic, MASS * speeds**2 / 2)
    np.testing.assert_allclose(states.observation.kinetic_energy, kinetic)
    np.testing.assert_allclose(states.value("kinetic_energy"), kinetic)
    _, places = jax.jit(jax.vmap(rollout, (0, None)))(states, PUSHES)
    np.testing.assert_allclose(places, [expected_places(PUSHES, speed=float(v)) for v in speeds], atol=1e-8)


def test_steps_are_those_of_a_run_with_a_sampled_controller():
    scene, ts = controlling.sampled_motor(0.01), np.linspace(0.0, 0.06, 4)
    state, angles = sj.start(scene), []
    for _ in range(3):
        state = sj.advance(state, 0.02)
        angles.append(2 * np.arcsin(state.quaternion("rotor")[3]))
    np.testing.assert_allclose(angles, controlling.sampled_answer(ts)[1:, 0], atol=1e-8)


def test_an_input_of_an_element_with_the_name_of_a_body():
    scene = block()
    named_alike = sj.Scene(scene.bodies, scene.joints, {"block": scene.forces["motor"]}, gravity=(0.0, 0.0, 0.0))
    for path in ("block.offset", "forces.block.offset"):
        state = sj.advance(sj.start(named_alike), 0.5, {path: 4.0})
        np.testing.assert_allclose(state.position("block")[0], 0.5 + 4.0 / MASS * 0.5**2 / 2, atol=1e-12)


def test_states_whose_equations_read_the_time_are_stepped_one_after_the_other_and_say_so():
    along = sj.Travel(("ground", "block"), (1.0, 0.0, 0.0))
    scene = block()
    shaken = sj.Scene(
        scene.bodies, scene.joints, {"motor": sj.Actuator(along, sj.functions.Sine(3.0, 1.0))}, gravity=(0, 0, 0)
    )
    states = jax.vmap(lambda _: sj.start(shaken))(jnp.zeros(2))
    with pytest.warns(sj.errors.SerialRunsWarning, match=r"Steps of sj\.advance.*input of the step"):
        after = jax.vmap(lambda state, push: sj.advance(state, 0.2, {"motor.offset": push}))(
            states, jnp.array([0.0, 2.0])
        )
    alone = [sj.advance(sj.start(shaken), 0.2, {"motor.offset": push}) for push in (0.0, 2.0)]
    np.testing.assert_allclose(after.y, [state.y for state in alone], atol=1e-9)


def test_wrong_inputs_are_named():
    state = sj.start(block())
    wrong: list[tuple[Any, str]] = [
        ({"moter.offset": 1.0}, r"no force element 'moter'; did you mean 'motor'\?"),
        ({"motor.ofset": 1.0}, r"did you mean 'offset'\?"),
        ({3: 1.0}, "3 is no path"),
        ({"motor.offset": "2"}, "'2' is no number"),
        ({"motor.offset": None}, "None is no number"),
        ({"motor.offset": True}, "True is no number"),
        ({"motor": 1.0}, "is no number but a Actuator"),
        ({"motor.offset": np.ones(2)}, "has the shape"),
        ({"motor.offset": np.nan}, "motor"),
        ({"bodies.block.mass": 1.0}, "is no input: there is no force element 'bodies'"),
        ({"motor.coordinate.direction": np.ones(3)}, "is no input: it is geometry"),
    ]
    for inputs, said in wrong:
        with pytest.raises(sj.SceneError, match=said):
            sj.advance(state, 0.1, inputs)
    for other, said in ((sj.simulate(block(), np.array([0.0, 0.1])), r"run\.end"), (block(), "a Scene is no state")):
        with pytest.raises(sj.SceneError, match=said):
            sj.advance(other, 0.1)  # pyright: ignore[reportArgumentType]
    for dt in (0.0, -1.0, np.nan):
        with pytest.raises(sj.SceneError, match="dt"):
            sj.advance(state, dt)


def test_a_step_that_fails_says_so_and_nothing_goes_on_from_it():
    state = sj.start(cases.pendulum(), max_steps=3)
    with pytest.warns(sj.SimulationWarning, match="max_steps"):
        failed = sj.advance(state, 5.0)
    assert 0 < failed.t < 5.0
    with pytest.raises(sj.SimulationError, match="max_steps"):
        sj.advance(failed, 0.1)
    with pytest.raises(sj.SimulationError, match="max_steps"):
        sj.advance(state, 5.0, throw=True)


@pytest.mark.slow  # beside it: the gradient of a page's example, `howto/go_on.md`, and the rollouts above
def test_a_rollout_has_derivatives():
    last = jax.jit(jax.grad(lambda pushes: rollout(sj.start(block()), pushes)[1][-1]))(PUSHES)
    steps = 1e-4 * np.eye(3)
    differences = [(expected_places(PUSHES + h)[-1] - expected_places(PUSHES - h)[-1]) / 2e-4 for h in steps]
    np.testing.assert_allclose(last, differences, rtol=1e-6)
