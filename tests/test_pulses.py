"""A pulse of a user's function of time is not passed over, if it lasts for a twenty-thousandth of the motion.

The reference is the impulse: a push of 1 N s on 1 kg at rest leaves 1 m/s, however short it is.
"""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj

TS = np.linspace(0.0, 1.0, 5)
AT = 0.4123
WIDTH = 6e-5


def box(t, width=WIDTH):
    return jnp.where((t > AT) & (t < AT + width), 1.0 / width, 0.0)


def bell(t, width=WIDTH):
    return jnp.exp(-(((t - AT) / width) ** 2)) / (width * np.sqrt(np.pi))


class Push(sj.forces.AbstractForce):
    """A user's own force."""

    size: float

    @property
    def body_names(self):
        return ("ball",)

    def wrenches(self, t, motions):
        return {"ball": sj.forces.Wrench(self.size * bell(t) * jnp.array([1.0, 0.0, 0.0]), jnp.zeros(3))}


class OwnFunction(sj.functions.AbstractFunction):
    """A user's own function, which does not say where it turns."""

    size: float

    def __call__(self, x):
        return self.size * bell(x)


def ball():
    return sj.Body(mass=1.0, inertia=(1e-3, 1e-3, 1e-3), points={"end": (0.0, 0.0, 0.0)})


def free(force):
    return sj.Scene({"ball": ball()}, forces={"push": force}, gravity=(0, 0, 0))


def pushed(function):
    return free(sj.AppliedWrench("ball", force=lambda t: function(t) * jnp.array([1.0, 0.0, 0.0])))


def on_rail(effort):
    rail = sj.Prismatic(("ground", "ball"), "ball.end", (1, 0, 0))
    actuator = sj.Actuator(sj.Travel(("ground", "ball"), (1, 0, 0)), effort=effort)
    return sj.Scene({"ball": ball()}, {"rail": rail}, forces={"push": actuator}, gravity=(0, 0, 0))


def turned(torque):
    wheel = sj.Body(mass=1.0, inertia=(1.0, 1.0, 1.0), points={"end": (0.0, 0.0, 0.0)})
    hinge = sj.Revolute(("ground", "ball"), "ball.end", (1, 0, 0))
    motor = sj.Actuator(sj.Turn(("ground", "ball"), (1, 0, 0)), effort=torque)
    return sj.Scene({"ball": wheel}, {"hinge": hinge}, forces={"push": motor}, gravity=(0, 0, 0))


def speed(scene, ts=TS, **how):
    return float(sj.simulate(scene, ts, **how).require_success().velocity("ball")[-1, 0])


SCENES = {
    "force, box": lambda: pushed(box),
    "force, bell": lambda: pushed(bell),
    "force of time and motion": lambda: free(
        sj.AppliedWrench("ball", force=lambda t, motions: bell(t) * jnp.array([1.0, 0.0, 0.0]))
    ),
    "actuator, box": lambda: on_rail(box),
    "actuator, own function": lambda: on_rail(OwnFunction(1.0)),
    "actuator, sum": lambda: on_rail(sj.functions.Sum(sj.functions.Constant(0.0), OwnFunction(1.0))),
    "own force": lambda: free(Push(1.0)),
}


@pytest.mark.parametrize("name", list(SCENES))
def test_short_pulse_gives_its_impulse(name):
    """Was: 0 m/s, a motion that had succeeded."""
    assert speed(SCENES[name]()) == pytest.approx(1.0, abs=3e-7)


def test_short_torque_gives_its_impulse():
    run = sj.simulate(turned(box), TS).require_success()
    assert float(run.angular_velocity("ball")[-1, 0]) == pytest.approx(1.0, abs=1e-5)
    assert "force 'push'" in run.stats.explanation
    assert "20,000" in run.stats.explanation


@pytest.mark.parametrize(
    "how",
    [
        {"solver": sj.solvers.Rodas5P()},
        pytest.param({"scalar": False}, marks=pytest.mark.slow),
        pytest.param({"solver": diffrax.Kvaerno5()}, marks=pytest.mark.slow),
        pytest.param({"solver": diffrax.Bosh3()}, marks=pytest.mark.slow),
        pytest.param({"adjoint": diffrax.RecursiveCheckpointAdjoint(), "max_steps": 4096}, marks=pytest.mark.slow),
    ],
    ids=["Rosenbrock", "array code", "diffrax", "few stages", "adjoint"],
)
def test_short_pulse_on_other_roads(how):
    assert speed(pushed(box), **how) == pytest.approx(1.0, abs=1e-5)


def test_two_pulses_are_both_met_wherever_they_are():
    """On a stage, between two, at the start and at the end."""
    for at in (0.0, 0.25, 0.5 - WIDTH, 1.0 - WIDTH):

        def two(t, at=at):
            return jnp.where((t >= at) & (t < at + WIDTH), 1.0 / WIDTH, 0.0) + bell(t - 0.3)

        assert speed(pushed(two)) == pytest.approx(2.0, abs=1e-6)


@pytest.mark.slow
def test_derivative_and_lanes():
    def end(size):
        return sj.simulate(free(Push(size)), TS).velocity("ball")[-1, 0]

    assert float(jax.jit(jax.grad(end))(2.0)) == pytest.approx(1.0, abs=1e-7)
    assert np.asarray(jax.vmap(end)(jnp.array([1.0, -2.0]))) == pytest.approx([1.0, -2.0], abs=1e-7)
    sizes = {"size": np.array([1.0, 3.0])}
    swept = sj.sweep(lambda size: free(Push(size)), sizes, jnp.asarray(TS), record=["final velocity.ball"])
    assert swept["final_velocity.ball"].values[:, 0] == pytest.approx([1.0, 3.0], abs=1e-7)


def test_shorter_pulses_are_met_where_they_are_declared():
    width = 1e-6

    def tiny(t):
        return jnp.where((t >= AT) & (t < AT + width), 1.0 / width, 0.0)

    declared = sj.functions.Piecewise([AT, AT + width], [tiny, tiny, tiny])
    assert speed(on_rail(declared)) == pytest.approx(1.0, abs=1e-6)


SMOOTH = {
    "slow sine": (lambda t: jnp.sin(3 * t), 110),
    "polynomial": (lambda t: 1.0 + t - 3 * t**2, 110),
    "exponential": (lambda t: jnp.exp(-10 * t), 110),
    "small noise beside a sine": (lambda t: jnp.sin(3 * t) + 1e-11 * jnp.sin(1e5 * t), 110),
}


@pytest.mark.parametrize("name", list(SMOOTH))
def test_smooth_functions_cost_no_step(name):
    """A hundredth of the motion is the longest step of a scene whose function is a user's own, as it was before."""
    function, most = SMOOTH[name]
    stats = sj.simulate(pushed(function), TS).require_success().stats
    assert int(stats.n_steps) <= most
    assert int(stats.n_rejected) == 0


def test_scenes_without_such_functions_have_no_looks():
    from spherejax.model.system import compile_scene, flatten_system
    from spherejax.motion.integration.unseen import unseen_of

    def looks(scene):
        return unseen_of(flatten_system(compile_scene(scene).system)[0], None, diffrax.Dopri8())

    assert looks(on_rail(box)) is not None
    for effort in (3.0, sj.functions.Sine(1.0, 2.0), sj.functions.Table([0.0, 0.5, 1.0], [0.0, 1.0, 0.0])):
        assert looks(on_rail(effort)) is None
    assert looks(free(sj.AppliedWrench("ball", force=(1.0, 0.0, 0.0)))) is None
    assert looks(pushed(lambda t: 1.0)) is None
