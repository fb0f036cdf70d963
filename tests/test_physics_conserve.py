"""What must not change: energy of ideal joints, momentum of free pairs, and the balance of energy in every model."""

from functools import partial

import cases
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import spherejax as sj
from spherejax.motion.equations.dynamics import state_rate
from spherejax.physics.kinematics import RelativeMotion
from spherejax.physics.state import State, pack

ENERGY = 0.05  # exchanged between weight and motion of the four-bar [J]


def test_ideal_joints_conserve_energy():
    run = sj.simulate(sj.gallery.four_bar(), cases.times(2.0, 41), rtol=1e-10, atol=1e-12).require_success()
    energy = np.asarray(run.mechanical_energy)
    assert np.ptp(np.asarray(run.kinetic_energy)) == pytest.approx(ENERGY, rel=0.8)
    assert np.abs(energy - energy[0]).max() < 1e-8 * ENERGY
    assert np.asarray(run.constraint_violation).max() < 1e-10
    assert np.asarray(run.velocity_violation).max() < 1e-9


def _largest_term(run, joint):
    terms = (run.kinetic_energy, run.potential_energy, run.elastic_energy, run.dissipated_energy(joint))
    return max(float(jnp.ptp(term)) for term in terms)


@pytest.mark.parametrize("name", [name for name in cases.FOUR_BAR_MODELS if name != "ideal"])
def test_balance_closes_in_every_model(name):
    scene = sj.gallery.four_bar(cases.FOUR_BAR_MODELS[name])
    run = sj.simulate(scene, cases.times(0.1, 41), rtol=1e-9, atol=1e-12, track_work=True).require_success()
    lost = np.asarray(run.dissipated_energy("coupler_rocker"))
    balance = np.asarray(run.mechanical_energy) + lost
    assert np.abs(balance - balance[0]).max() < 1e-6 * _largest_term(run, "coupler_rocker")
    # Nothing gives energy back for good. The samples may fall into a contact, where an instant's elastic energy counts.
    assert lost.min() > -1e-9 * ENERGY
    assert lost[-1] > 1e-6 * ENERGY


def pressed(model, load=2000.0, speed=0.0):
    """A heavy ball pressed into its socket by a constant load."""
    scene = cases.ball_in_socket(model, 2.0, (0.0, 0.0, -speed))
    push = sj.AppliedWrench("ball", force=(0.0, 0.0, -load))
    return sj.Scene(
        scene.bodies, scene.joints, {"push": push}, gravity=(0.0, 0.0, 0.0), ground_points=scene.ground_points
    )


@pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning")  # pressed beyond what Eq. 24 is for
@pytest.mark.slow
def test_balance_closes_for_a_hybrid_film_pressed_into_contact():
    load, wide = 2000.0, 2e-5
    model = sj.Lubricated(clearance=cases.C, viscosity=0.004, e_h0=wide, e_h1=wide)
    run = sj.simulate(
        pressed(model, load, 0.1),
        cases.times(0.01, 81),
        rtol=1e-9,
        atol=1e-13,
        track_work=True,
        solver=sj.solvers.Rodas5P(),
    ).require_success()
    depth = np.asarray(run.penetration("joint"))
    assert (depth < 0).any()
    assert ((depth > 0) & (depth < wide)).any()
    moved = -load * np.asarray(run.position("ball"))[:, 2]  # minus the work of the load
    kinetic, elastic = np.asarray(run.kinetic_energy), np.asarray(run.elastic_energy)
    lost = np.asarray(run.dissipated_energy("joint"))
    balance = kinetic - moved + elastic + lost
    largest = max(np.ptp(kinetic), np.ptp(moved), np.ptp(elastic), np.ptp(lost))
    assert np.abs(balance - balance[0]).max() < 1e-6 * largest
    assert np.diff(lost).min() > -1e-9 * largest  # film and hysteresis only take


def test_elastic_energy_of_the_hybrid_integrates_the_blended_force():
    # A film without viscosity to speak of, over Hertz's contact: all the work that goes in is stored.
    stiffness, wide = 1e10, 1e-5
    model = sj.Lubricated(
        clearance=cases.C, viscosity=1e-12, e_h0=wide, e_h1=2 * wide, normal=sj.Hertz(stiffness=stiffness)
    )
    scene = cases.ball_in_socket(model, 0.2, (0.0, 0.0, -4.0))
    with pytest.warns(sj.errors.OutOfRangeWarning, match="^joint 'joint': the offset e_h1"):  # wide, for a depth to see
        run = sj.simulate(
            scene, cases.times(1.5e-4, 61), rtol=1e-10, atol=1e-14, solver=sj.solvers.Rodas5P(), track_work=True
        )
    depth, elastic = np.asarray(run.penetration("joint")), np.asarray(run.elastic_energy)
    assert depth.max() > 1.5 * wide

    def stored(d):
        if d <= 0:
            return 0.0
        return quad(lambda x: min(x / wide, 1.0) * stiffness * x**1.5, 0.0, d, points=[min(wide, d)], epsrel=1e-12)[0]

    assert elastic == pytest.approx([stored(d) for d in depth], abs=1e-9 * elastic.max())
    work = np.asarray(run.absorbed_work("joint"))
    assert work == pytest.approx(elastic, abs=1e-6 * elastic.max())


@pytest.mark.parametrize("name", ["hertz", "perfect_restitution", "undamped_bushing"])
def test_conservative_joints_return_everything(name):
    model = {
        "hertz": sj.Dry(clearance=cases.C, normal=sj.Hertz(stiffness=1e10)),
        "perfect_restitution": sj.Dry(clearance=cases.C, normal=sj.LankaraniNikravesh(restitution=1.0, stiffness=1e10)),
        "undamped_bushing": sj.Bushing(stiffness=1e6, damping=0.0),
    }[name]
    run = sj.simulate(
        cases.ball_in_socket(model, 0.2, (0.3, 0.0, 0.4)), cases.times(1e-3, 21), rtol=1e-10, atol=1e-13
    ).require_success()
    energy = np.asarray(run.mechanical_energy)
    assert np.abs(energy - energy[0]).max() < 1e-7 * energy[0]


def free_pair(model):
    """Two bodies in one joint, spinning and drifting; no ground, no weight."""
    inertia = np.array([[2e-3, 1e-4, 2e-4], [1e-4, 3e-3, -1e-4], [2e-4, -1e-4, 2.5e-3]])
    first = sj.Body(
        1.0, inertia, velocity=(0.1, 0.2, 0.3), angular_velocity=(3.0, 2.0, 1.0), points={"socket": (0.05, 0.0, 0.0)}
    )
    second = sj.Body(0.5, inertia / 2, position=(0.1, 0.0, 0.0), points={"ball": (-0.05, 0.0, 0.0)})
    return sj.Scene(
        {"first": first, "second": second},
        {"pair": sj.Spherical("first.socket", "second.ball", model)},
        gravity=(0.0, 0.0, 0.0),
    )


def _momenta(run):
    linear, angular = 0.0, 0.0
    for name, body in run.system.bodies.items():
        q = np.asarray(run.quaternion(name))
        w, r, v = (np.asarray(f(name)) for f in (run.angular_velocity, run.position, run.velocity))
        rotation = _matrices(q)
        spin = np.einsum("nij,jk,nlk,nl->ni", rotation, np.asarray(body.inertia), rotation, w)
        linear = linear + body.mass * v
        angular = angular + spin + body.mass * np.cross(r, v)
    return linear, angular


def _matrices(q):
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.array(q), scalar_first=True).as_matrix()


@pytest.mark.filterwarnings("ignore::spherejax.errors.StartWarning")  # the velocities are made to agree with the joint
@pytest.mark.parametrize(
    "name",
    [
        "ideal",
        "dry",
        "friction",
        pytest.param("lubricated", marks=pytest.mark.slow),
        "bushing",
        "bushing_matrix",
        "bushing_rubber_turning",
    ],
)
def test_momentum_of_a_free_pair_is_conserved(name):
    run = sj.simulate(free_pair(cases.MODELS[name]), cases.times(0.05, 11), rtol=1e-10, atol=1e-13).require_success()
    linear, angular = _momenta(run)
    assert np.abs(linear - linear[0]).max() < 1e-9 * np.abs(linear).max()
    # With friction as well: both bodies feel it in one point.
    assert np.abs(angular - angular[0]).max() < 1e-9 * np.abs(angular).max()


def test_joints_and_bodies_keep_their_names_whatever_their_order():
    # Two balls in two sockets of their own, one of them damped, named against the alphabet.
    balls = {
        "zeta": sj.Body(0.2, (1e-5,) * 3, velocity=(0.5, 0.0, 0.0), points={"p": (0.0, 0.0, 0.0)}),
        "alpha": sj.Body(0.4, (1e-5,) * 3, velocity=(0.0, 0.2, 0.0), points={"p": (0.0, 0.0, 0.0)}),
    }
    joints = {
        "y_damped": sj.Spherical("ground.s", "zeta.p", sj.Bushing(1e4, 1e-3), starts_concentric=False),
        "b_elastic": sj.Spherical("ground.s", "alpha.p", sj.Bushing(1e4, 0.0), starts_concentric=False),
    }
    scene = sj.Scene(balls, joints, gravity=(0.0, 0.0, 0.0), ground_points={"s": (0.0, 0.0, 0.0)})
    run = sj.simulate(scene, cases.times(1e-2, 5), rtol=1e-9, atol=1e-12, track_work=True).require_success()
    assert np.asarray(run.velocity("zeta"))[0] == pytest.approx([0.5, 0.0, 0.0])
    assert np.asarray(run.velocity("alpha"))[0] == pytest.approx([0.0, 0.2, 0.0])
    assert np.abs(np.asarray(run.position("alpha"))[:, 0]).max() < 1e-12
    assert float(run.dissipated_energy("y_damped")[-1]) > 1e-3
    assert abs(float(run.dissipated_energy("b_elastic")[-1])) < 1e-9
    assert np.abs(np.asarray(run.acceleration("alpha"))[:, 0]).max() < 1e-9


def test_bristles_of_two_joints_do_not_mix():
    # Two balls in sockets, in contact; only the one that is named last in the alphabet, and first in the scene, slides.
    depth, spin = cases.C + 1e-6, (0.0, 0.0, 20.0)
    place = {"points": {"p": (0.0, 0.0, 0.0)}, "position": (depth, 0.0, 0.0)}
    bodies = {
        "zeta": sj.Body(0.2, (1e-5,) * 3, angular_velocity=spin, **place),
        "alpha": sj.Body(0.2, (1e-5,) * 3, **place),
    }
    model = sj.Dry(clearance=cases.C, friction=sj.LuGre())
    joints = {
        "y_slides": sj.Spherical("ground.s", "zeta.p", model, starts_concentric=False),
        "b_rests": sj.Spherical("ground.s", "alpha.p", model, starts_concentric=False),
    }
    scene = sj.Scene(bodies, joints, gravity=(0.0, 0.0, 0.0), ground_points={"s": (0.0, 0.0, 0.0)})
    system = sj.equations.compile_scene(scene).system
    layout = system.layout
    state = State(
        *(
            np.stack([np.asarray(getattr(body, field)) for body in system.bodies.values()])
            for field in ("position", "quaternion", "velocity", "angular_velocity")
        ),
        memory=np.tile([0.1, 0.0, 0.0, 0.0], 2),
        work=np.zeros(0),
    )
    rates = np.asarray(state_rate(system, 0.0, pack(state)))[layout.memory_start : layout.work_start]
    sliding = (0.010 - cases.C - 0.5e-6) * 20.0  # the ball's point in contact, along y: (R_j - delta/2) w
    assert rates[system.memory_of("y_slides")] == pytest.approx([0.0, 0.0, sliding, 0.0], rel=1e-12)
    assert rates[system.memory_of("b_rests")] == pytest.approx(np.zeros(4), abs=1e-15)


class Springy(sj.Dry):
    """A joint of a user's own that stores more than its surfaces do."""

    def respond(self, motion, memory):
        found = super().respond(motion, memory)
        return found._replace(elastic_energy=found.elastic_energy + 1.0)


@pytest.mark.parametrize("kind", [sj.Dry, partial(sj.Lubricated, e_h0=1e-6, e_h1=2e-6), Springy])
@pytest.mark.parametrize("friction", [None, sj.Threlfall(), sj.LuGre()], ids=repr)
def test_what_a_joint_stores_is_told_without_the_rest_of_its_answer(kind, friction):
    model = kind(cases.C, friction=friction)
    still, upright = jnp.zeros(3), jnp.array([1.0, 0.0, 0.0, 0.0])
    memory = jnp.array([0.1, 1e-6, 0.0, 0.0])[: len(model.memory)]
    stored = []
    for depth in (-3e-5, 4e-7, 5e-6):
        e = (cases.C + depth) * jnp.array([0.6, 0.0, 0.8])
        motion = RelativeMotion(e, still, jnp.eye(3), upright, still, still)
        stored.append(float(model.respond(motion, memory).elastic_energy))
        assert float(model.stored_energy(motion, memory)) == stored[-1]
    assert stored[0] < stored[1] < stored[2]
