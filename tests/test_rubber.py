"""Rubber that relaxes and rubs inside: branches and friction of a bushing against closed forms."""

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import cumulative_simpson, solve_ivp
from scipy.linalg import expm

import spherejax as sj
from spherejax.foundations.rotation import quaternion_from_rotation_vector, quaternion_product, rotation_matrix
from spherejax.physics.kinematics import RelativeMotion

K, TIMES, STIFFNESSES = 2e5, np.array([0.1, 0.01]), np.array([1e5, 5e4])  # N/m, s, N/m
LIMIT, HALF = 40.0, 1e-4  # N, m
BRANCHES = sj.laws.Maxwell(STIFFNESSES, TIMES)
FRICTION = sj.laws.Berg(LIMIT, HALF)
SPRING = sj.laws.VectorElastomer(K, 0.0)
MASS = 2.0


def names_of(model):
    return tuple(entry.name for entry in model.memory)


def pressed(model, force=0.0):
    """A ball in rubber, under a constant force along x."""
    scene = cases.ball_in_socket(model, mass=MASS)
    push = {} if force is None else {"push": sj.AppliedWrench("ball", force=(force, 0.0, 0.0))}
    return sj.Scene(scene.bodies, scene.joints, push, gravity=(0.0, 0.0, 0.0), ground_points=scene.ground_points)


def driven(model, displacement):
    """A ball in rubber whose displacement along x is prescribed."""
    pair = ("ground", "ball")
    scene = cases.ball_in_socket(model, mass=MASS)
    guide = sj.Prismatic(pair, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    driver = sj.TranslationDriver(pair, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), displacement)
    joints = {**scene.joints, "guide": guide, "driver": driver}
    return sj.Scene(scene.bodies, joints, gravity=(0.0, 0.0, 0.0), ground_points=scene.ground_points)


def resistance(run):
    """Against the displacement, along x [N]."""
    return -np.asarray(run.reaction("joint"))[:, 0]


def linear_motion(ts, start, force=0.0, stiffnesses=STIFFNESSES, times=TIMES, damping=0.0):
    """Deflection, velocity and deflections of the branches, by the exponential of their matrix."""
    n = len(times)
    A = np.zeros((n + 3, n + 3))
    A[0, 1] = 1.0
    A[1, :2] = -K / MASS, -K * damping / MASS
    A[1, 2 : n + 2] = -np.asarray(stiffnesses) / MASS
    A[1, -1] = force / MASS
    A[2 : n + 2, 1] = 1.0
    A[2 : n + 2, 2 : n + 2] = -np.diag(1 / np.asarray(times))
    return np.array([expm(A * t) @ [*start, *np.zeros(n), 1.0] for t in np.asarray(ts)])[:, :-1]


# Motions against closed forms -----------------------------------------------------------------------------------------


def test_creep_under_a_constant_load():
    ts = np.linspace(0.0, 0.5, 26)
    model = sj.Bushing(law=sj.laws.VectorElastomer(K, 1e-3), branches=BRANCHES)
    run = sj.simulate(pressed(model, 30.0), ts, rtol=1e-10).require_success()
    exact = linear_motion(ts, (0.0, 0.0), 30.0, damping=1e-3)
    assert np.asarray(run.eccentricity("joint"))[:, 0] == pytest.approx(exact[:, 0], abs=1e-11)
    memory = np.asarray(run.state.memory).reshape(len(ts), 2, 3)
    assert memory[:, :, 0] == pytest.approx(exact[:, 2:], abs=1e-11)
    assert np.all(memory[:, :, 1:] == 0.0)
    # It begins as stiff as all springs together, and ends as stiff as the elastomer alone.
    assert exact[-1, 0] == pytest.approx(30.0 / K, rel=2e-2)
    assert np.asarray(run.parts("joint")["branch_force"])[:, 0] == pytest.approx(-exact[:, 2:] @ STIFFNESSES, abs=1e-6)


def test_what_branches_dissipate_is_accounted_for():
    """The balance of a vibration without another damper, against the integral of sum k e^2/tau of the exact motion."""
    ts = np.linspace(0.0, 0.05, 401)
    scene = cases.ball_in_socket(sj.Bushing(law=SPRING, branches=BRANCHES), mass=MASS, velocity=(0.05, 0.0, 0.0))
    run = sj.simulate(scene, ts, rtol=1e-10, track_work=True).require_success()
    powers = linear_motion(ts, (0.0, 0.05))[:, 2:] ** 2 @ (STIFFNESSES / TIMES)
    lost = np.asarray(run.dissipated_energy("joint"))
    assert lost == pytest.approx(cumulative_simpson(powers, x=ts, initial=0.0), abs=1e-6 * lost[-1])
    energy = np.asarray(run.mechanical_energy)
    assert energy + lost == pytest.approx(energy[0], rel=1e-7)
    assert lost[-1] > 0.1 * energy[0]


def test_relaxation_after_a_step():
    step = sj.functions.SmoothStep(0.0, 1e-3, 0.0, 1e-3)
    ts = np.concatenate([[0.0], np.linspace(1e-3, 0.3, 31)])
    run = sj.simulate(driven(sj.Bushing(law=SPRING, branches=BRANCHES), step), ts, rtol=1e-10).require_success()
    lasting = resistance(run)[1:] - K * 1e-3
    at_end = np.asarray(run.state.memory)[1].reshape(2, 3)[:, 0]
    assert at_end == pytest.approx([1e-3, 1e-3], rel=0.06)  # nearly all of the step, which took a tenth of 0.01 s
    fading = np.exp(-(ts[1:, None] - ts[1]) / TIMES)
    assert lasting == pytest.approx(fading @ (STIFFNESSES * at_end), abs=1e-6)


def test_steady_pull_is_resisted_as_by_dampers():
    ts, speed = np.linspace(0.0, 1.0, 11), 2e-3
    run = sj.simulate(driven(sj.Bushing(law=SPRING, branches=BRANCHES), sj.functions.Linear(speed)), ts, rtol=1e-10)
    grown = STIFFNESSES * TIMES * speed * (1 - np.exp(-ts[:, None] / TIMES))
    assert resistance(run.require_success()) == pytest.approx(K * speed * ts + grown.sum(1), abs=1e-6)


def harmonic(model, frequency, amplitude, cycles, n=64):
    """Resistance over the last cycle of a driven joint, at n equal times, and the times."""
    ts = np.concatenate([[0.0], (cycles - 1 + np.arange(n) / n) / frequency])
    run = sj.simulate(driven(model, sj.functions.Sine(amplitude, frequency)), ts, rtol=1e-9).require_success()
    return ts[1:], resistance(run)[1:]


@pytest.mark.parametrize("frequency", [1.0, 8.0, 60.0])
def test_complex_stiffness_of_branches(frequency):
    cycles = int(np.ceil(2.5 * frequency)) + 1  # 25 times the longest relaxation
    cycles = min(cycles, 40)
    ts, force = harmonic(sj.Bushing(law=SPRING, branches=BRANCHES), frequency, 1e-3, cycles)
    w = 2 * np.pi * frequency
    exact = K + np.sum(STIFFNESSES * 1j * w * TIMES / (1 + 1j * w * TIMES))
    found = np.mean(force * np.exp(-1j * w * ts)) * 2j / 1e-3
    left = np.exp(-(cycles - 1) / frequency / TIMES[0])  # what remains of the start
    assert abs(found - exact) < (1e-6 + left) * abs(exact)


def berg_peak(r):
    """Of a steady loop, as a share of the limit."""
    return (np.sqrt(1 + 4 * r * r) - 1) / (2 * r)


def berg_loss(r):
    """Of a steady loop, in units of F_max x_2."""
    f = berg_peak(r)
    return 2 * (2 * r - np.log((1 + f) / (1 - f)))


@pytest.mark.parametrize("r", [0.3, 1.0, 10.0])
def test_friction_loop_against_its_closed_form(r):
    amplitude, n = r * HALF, 256
    cycles = int(np.ceil(2.0 / r)) + 2  # a cycle forgets by exp(-8 r) for small r
    ts, force = harmonic(sj.Bushing(law=SPRING, friction=FRICTION), 2.0, amplitude, cycles, n)
    x = amplitude * np.sin(4 * np.pi * ts)
    inner = force - K * x
    assert np.max(inner) == pytest.approx(LIMIT * berg_peak(r), rel=1e-5)
    loss = np.mean(inner * 4 * np.pi * amplitude * np.cos(4 * np.pi * ts)) / 2.0  # over a cycle of half a second
    assert loss == pytest.approx(LIMIT * HALF * berg_loss(r), rel=2e-3)


def test_friction_is_berg_s_curve_from_rest_and_stiffer_for_small_amplitudes():
    ts = np.linspace(0.0, 1.0, 21)
    run = sj.simulate(driven(sj.Bushing(law=SPRING, friction=FRICTION), sj.functions.Linear(5e-4)), ts, rtol=1e-10)
    x = 5e-4 * ts
    assert resistance(run.require_success()) == pytest.approx(K * x + LIMIT * x / (x + HALF), abs=1e-6)
    r = np.array([1e-3, 0.1, 1.0, 10.0])
    stiffness = LIMIT * berg_peak(r) / (r * HALF)
    assert np.all(np.diff(stiffness) < 0)
    assert stiffness[0] == pytest.approx(LIMIT / HALF, rel=1e-5)
    assert berg_loss(1e-2) == pytest.approx(8 / 3 * 1e-2**3, rel=1e-3)  # as Berg's own loop


def bergs_own(u, start):
    """F/F_max at u x_2 from a turning point where it is `start`, as x rises: the published law."""
    return start + u / (1 - start + u) * (1 - start)


def test_how_it_differs_from_berg_s_own_law_is_as_the_docstring_says():
    u = np.linspace(0.0, 5.0, 11)
    assert bergs_own(u, 0.0) == pytest.approx(u / (1 + u), abs=1e-15)  # one curve from rest
    for r, share in ((1e-3, None), (1.0, 0.41), (30.0, None)):
        end = 0.0
        for _ in range(2000):  # cycles until the loop is closed: the force at one end is minus that at the other
            end = 0.5 * (end + bergs_own(2 * r, -end))
        assert end == pytest.approx((np.sqrt(1 + 6 * r + r * r) - 1 - r) / 2, rel=1e-9)
        if share is not None:
            assert end == pytest.approx(share, abs=0.005)
            assert berg_peak(r) == pytest.approx(0.62, abs=0.005)
        if r < 0.1:
            assert 1 - end / r == pytest.approx(2 * r, rel=0.01)
            assert 1 - berg_peak(r) / r == pytest.approx(r * r, rel=0.01)
            x = np.linspace(-r, r, 2001)
            rising = bergs_own(x + r, -end)
            loss = 2 * np.trapezoid(rising, x)  # the falling curve is the rising one turned about the origin
            assert loss == pytest.approx(8 / 3 * r**3, rel=0.01)
    # Its slope is that of `sj.laws.Berg` over (1 - mu)^2.
    slope = (bergs_own(0.3 + 1e-6, -0.5) - bergs_own(0.3 - 1e-6, -0.5)) / 2e-6
    assert slope == pytest.approx((1 - bergs_own(0.3, -0.5)) ** 2 / 1.5**2, rel=1e-8)


def test_free_vibration_with_friction_against_another_integrator():
    model = sj.Bushing(law=SPRING, friction=FRICTION)
    scene = cases.ball_in_socket(model, mass=MASS, velocity=(0.05, 0.03, 0.0))
    ts = np.linspace(0.0, 0.1, 11)
    run = sj.simulate(scene, ts, rtol=1e-9, track_work=True).require_success()

    def rate(t, y):
        e, v, z = y.reshape(3, 3)
        sliding = v - z / HALF * (2 * np.linalg.norm(v) - z @ v / HALF)
        return np.concatenate([v, -(K * e + LIMIT * z / HALF) / MASS, sliding])

    start = np.array([0.0, 0.0, 0.0, 0.05, 0.03, 0.0, 0.0, 0.0, 0.0])
    exact = solve_ivp(rate, (0.0, 0.1), start, "DOP853", ts, rtol=1e-11, atol=1e-15).y
    assert np.asarray(run.eccentricity("joint")) == pytest.approx(exact[:3].T, abs=1e-10)
    assert float(run.mechanical_energy[-1]) < 0.8 * float(run.mechanical_energy[0])


# What must hold at any motion -----------------------------------------------------------------------------------------

HINGE = sj.laws.HingeElastomer(np.diag([3e4, 3e4, 0.0]), np.zeros((3, 3)), 50.0)
CROSS = sj.laws.CrossElastomer(3e4 * np.eye(3), np.zeros((3, 3)), 50.0)
SIX = sj.laws.MatrixElastomer(3e4 * np.eye(3), np.zeros((3, 3)), 50.0 * np.eye(3))
TURNING = {"rotational_stiffness": [[30.0, 20.0, 10.0], [5.0, 5.0, 5.0]]}
SLIDING = {"branches": sj.laws.Maxwell([[2e4, 2e4, 0.0], [1e4, 1e4, 0.0]], TIMES, **TURNING)}
TILTED = {"rotational_limit": 0.3, "half_angle": 0.02}
MODELS = {
    "vector": sj.Bushing(law=SPRING, branches=BRANCHES, friction=FRICTION),
    "radial": sj.Bushing(K, 0.0, branches=BRANCHES, friction=FRICTION),
    "curve": sj.Bushing(law=sj.laws.CurveElastomer([1e-4, 1e-3], [10.0, 200.0], 0.0), friction=FRICTION),
    "six": sj.Bushing(
        law=SIX, branches=sj.laws.Maxwell(STIFFNESSES, TIMES, **TURNING), friction=sj.laws.Berg(LIMIT, HALF, **TILTED)
    ),
    "hinge": sj.Bushing(law=HINGE, **SLIDING, friction=sj.laws.Berg([40.0, 40.0, 0.0], HALF, **TILTED)),
    "cross": sj.Bushing(law=CROSS, **SLIDING, friction=sj.laws.Berg(LIMIT, HALF, **TILTED)),
}
models = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


def moving(values):
    """A relative motion from eighteen numbers: two rotations, deflection, three rates."""
    socket, turn, e, e_rate, socket_spin, ball_spin = np.asarray(values).reshape(6, 3)
    axes = rotation_matrix(quaternion_from_rotation_vector(jnp.asarray(socket)))
    return RelativeMotion(
        1e-3 * e, 0.1 * e_rate, axes, quaternion_from_rotation_vector(0.3 * jnp.asarray(turn)), socket_spin, ball_spin
    )


def remembered(model, values):
    """Deflections of the memory, friction's within its bound."""
    scales = {"m": 0.5 * HALF, "rad": 1e-2}
    return np.clip(values[: len(model.memory)], -1, 1) * np.array([scales[entry.unit] for entry in model.memory]) * 0.9


@models
def test_power_is_stored_or_dissipated_at_any_motion(model):
    """With nothing else dissipating: the power taken, less the rate of the stored energy, is that of branches and
    friction by their formulas."""

    @jax.jit
    def powers(motion, memory):
        response = model.respond(motion, memory)
        taken = -(
            response.force @ motion.eccentricity_rate
            + response.ball_moment @ motion.ball_angular_velocity
            + response.socket_moment @ motion.socket_angular_velocity
        )

        def energy(h):
            """After a time h at the same rates: the socket's axes turn, and the ball against them."""
            spin, relative = (
                motion.socket_angular_velocity,
                motion.ball_angular_velocity - motion.socket_angular_velocity,
            )
            turned = quaternion_from_rotation_vector(h * spin)
            local = quaternion_from_rotation_vector(h * (motion.socket_rotation.T @ relative))
            later = motion._replace(
                eccentricity=motion.eccentricity + h * motion.eccentricity_rate,
                socket_rotation=rotation_matrix(turned) @ motion.socket_rotation,
                relative_quaternion=quaternion_product(local, motion.relative_quaternion),
            )
            return model.respond(later, memory + h * response.memory_rate).elastic_energy

        return taken, jax.jvp(energy, (0.0,), (1.0,))[1], response.memory_rate

    random = np.random.default_rng(5)
    for _ in range(200):
        motion, memory = moving(random.standard_normal(18)), remembered(model, random.standard_normal(24))
        taken, stored, rates = (np.asarray(x) for x in powers(motion, memory))
        lost = dissipated(model, motion, memory)
        assert taken - stored == pytest.approx(lost, rel=1e-7, abs=1e-9 * (abs(taken) + abs(stored) + lost))
        assert lost >= 0.0
        assert np.isfinite(rates).all()


def dissipated(model, motion, memory):
    """Written out once more, vector by vector."""
    names = [name.rpartition("_")[0] for name in names_of(model)[::3]]
    kept = dict(zip(names, memory.reshape(-1, 3), strict=True))
    axes = np.asarray(motion.socket_rotation)
    rate = axes.T @ (motion.eccentricity_rate - np.cross(motion.socket_angular_velocity, motion.eccentricity))
    lost = 0.0
    for k, tau in enumerate(TIMES if model.branches is not None else ()):
        along = np.broadcast_to(model.branches.stiffness[k], 3)
        lost += np.sum(along * kept[f"branch_{k + 1}"] ** 2) / tau
        if f"branch_{k + 1}_turn" in kept:
            lost += np.sum(np.asarray(TURNING["rotational_stiffness"])[k] * kept[f"branch_{k + 1}_turn"] ** 2) / tau
    turn_rate = np.asarray(model.law.resisted_rotation(model.law.measure_of_rotation(motion.relative_quaternion))) @ (
        axes.T @ (motion.ball_angular_velocity - motion.socket_angular_velocity)
    )
    for name, v, limit, half in (
        ("friction", rate, np.asarray(model.friction.limit), HALF),
        ("friction_turn", turn_rate, 0.3, 0.02),
    ):
        if name in kept:
            z, v = kept[name], np.where(limit > 0, v, 0.0)
            lost += np.sum(limit * z * z) / half**2 * (2 * np.linalg.norm(v) - z @ v / half)
    return lost


@models
def test_a_rigid_rotation_of_the_pair_changes_nothing(model):
    """Force and moment turn with the pair, and the memory does not notice, however fast it turns."""
    random = np.random.default_rng(7)
    respond = jax.jit(lambda motion, memory: model.respond(motion, memory))
    for _ in range(20):
        motion, memory = moving(random.standard_normal(18)), remembered(model, random.standard_normal(24))
        Q = rotation_matrix(quaternion_from_rotation_vector(jnp.asarray(random.standard_normal(3))))
        W = 30.0 * random.standard_normal(3)
        turned = motion._replace(
            eccentricity=Q @ motion.eccentricity,
            eccentricity_rate=Q @ motion.eccentricity_rate + jnp.cross(W, Q @ motion.eccentricity),
            socket_rotation=Q @ motion.socket_rotation,
            socket_angular_velocity=W + Q @ motion.socket_angular_velocity,
            ball_angular_velocity=W + Q @ motion.ball_angular_velocity,
        )
        before, after = respond(motion, memory), respond(turned, memory)
        scale = np.abs(before.memory_rate).max()
        assert np.asarray(after.memory_rate) == pytest.approx(np.asarray(before.memory_rate), abs=1e-11 * scale)
        for name in ("force", "ball_moment", "socket_moment"):
            expected = np.asarray(Q @ getattr(before, name))
            assert np.asarray(getattr(after, name)) == pytest.approx(expected, abs=1e-10 * (np.abs(expected).max() + 1))


def test_a_hinge_turns_freely_and_a_cross_about_both_arms():
    for law, spin in ((HINGE, (0.0, 0.0, 5.0)), (CROSS, (3.0, 0.0, 5.0))):
        model = sj.Bushing(law=law, **SLIDING, friction=sj.laws.Berg([1.0, 1.0, 0.0], HALF, **TILTED))
        zero = np.zeros(3)
        motion = moving(np.zeros(18))._replace(ball_angular_velocity=np.array(spin), eccentricity=zero)
        response = model.respond(motion, jnp.zeros(len(model.memory)))
        assert np.abs(response.memory_rate).max() < 1e-15


def test_friction_stays_within_its_limit_on_any_path():
    """Steps of random velocity, integrated by another program."""
    random = np.random.default_rng(3)
    friction = sj.laws.Berg(LIMIT, HALF)
    rate = jax.jit(lambda z, v: friction.rate(z, v))
    z, largest = np.zeros(3), 0.0
    for _ in range(60):
        v = random.standard_normal(3) * 10 ** random.uniform(-4, 0)
        time = 2 * HALF / np.linalg.norm(v)
        z = solve_ivp(lambda t, z, v=v: np.asarray(rate(z, v)), (0, time), z, rtol=1e-8, atol=1e-12).y[:, -1]
        largest = max(largest, np.linalg.norm(z))
    assert 0.6 * HALF < largest <= HALF * (1 + 1e-6)


@models
def test_derivatives_are_finite_at_rest_and_agree(model):
    memory = jnp.zeros(len(model.memory))

    def answer(e, rate, memory):
        motion = moving(np.zeros(18))._replace(eccentricity=e, eccentricity_rate=rate)
        response = model.respond(motion, memory)
        return jnp.concatenate([response.force, response.ball_moment, response.memory_rate])

    at = (jnp.zeros(3), jnp.zeros(3), memory)
    forward, reverse = (jax.jit(jac(answer, (0, 1, 2)))(*at) for jac in (jax.jacfwd, jax.jacrev))
    for a, b in zip(forward, reverse, strict=True):
        assert np.isfinite(a).all()
        assert np.asarray(a) == pytest.approx(np.asarray(b), abs=1e-9)


# Only where it is asked for -------------------------------------------------------------------------------------------


def test_nothing_is_compiled_in_unasked():
    plain = sj.Bushing(law=SPRING)
    assert plain.memory == ()
    assert sj.equations.compile_scene(sj.gallery.four_bar(plain)).system.layout.n_memory == 0
    rubber = sj.Bushing(law=SPRING, branches=BRANCHES, friction=FRICTION)
    assert sj.equations.compile_scene(sj.gallery.four_bar(rubber)).system.layout.n_memory == 9
    effects = [effect.name for effect in rubber.effects]
    assert effects == [
        "elastomer, translation (VectorElastomer)",
        "relaxation, 2 branches (Maxwell)",
        "friction in the rubber (Berg)",
    ]
    shapes = [len(effect.model.memory) for effect in rubber.effects]
    assert shapes == [0, 6, 9]
    turning = MODELS["six"]
    assert names_of(turning)[:4] == ("branch_1_x", "branch_1_y", "branch_1_z", "branch_2_x")
    assert names_of(turning)[-3:] == ("friction_turn_x", "friction_turn_y", "friction_turn_z")
    assert tuple(entry.unit for entry in turning.memory) == ("m",) * 6 + ("rad",) * 6 + ("m",) * 3 + ("rad",) * 3


# Methods and tolerances -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rtol", [1e-5, 1e-8])
def test_a_fast_branch_gets_a_stiff_method(rtol):
    model = sj.Bushing(law=sj.laws.VectorElastomer(K, 1e-3), branches=sj.laws.Maxwell(STIFFNESSES, [0.1, 1e-8]))
    ts = np.linspace(0.0, 0.05, 6)
    run = sj.simulate(pressed(model, 30.0), ts, rtol=rtol, max_steps=2000).require_success()
    assert "Ro" in run.stats.explanation.split(":")[0]
    assert "1.0e+08 per second" in run.stats.explanation
    # A branch that fast is a damper of k tau.
    exact = linear_motion(ts, (0.0, 0.0), 30.0, STIFFNESSES[:1], TIMES[:1], damping=1e-3 + STIFFNESSES[1] * 1e-8 / K)
    assert np.asarray(run.eccentricity("joint"))[:, 0] == pytest.approx(exact[:, 0], abs=10 * rtol * 1e-3 + 1e-9)


@pytest.mark.slow
def test_friction_of_a_short_reach_gets_a_stiff_method():
    explanations = []
    for half in (1e-4, 1e-9):
        model = sj.Bushing(law=sj.laws.VectorElastomer(K, 1e-3), friction=sj.laws.Berg(0.1, half))
        run = sj.simulate(sj.gallery.four_bar(model), np.linspace(0.0, 0.01, 3), max_steps=5000).require_success()
        explanations.append(run.stats.explanation.partition(":")[0])
    assert explanations == ["Dopri8", "Rodas5P"]


def test_slow_branches_keep_the_explicit_method():
    run = sj.simulate(pressed(sj.Bushing(law=SPRING, branches=BRANCHES), 30.0), np.linspace(0.0, 0.01, 2))
    assert run.stats.explanation.startswith("Dopri8")


def test_histories_of_rubber_can_be_drawn():
    run = sj.simulate(sj.gallery.four_bar(MODELS["vector"]), np.linspace(0.0, 0.01, 5)).require_success()
    curves = sj.plot.curves_of(run, "rubber", body="rocker", joint="coupler_rocker")
    assert curves.sliding_speed is None
    assert run.to_xarray()["memory"].values[0] == "coupler_rocker.branch_1_x"


def test_errors_of_remembered_deflections_are_judged_as_those_of_positions():
    from spherejax.motion.start.tolerances import component_tolerances

    system = sj.equations.compile_scene(sj.gallery.four_bar(MODELS["six"])).system
    tolerances = component_tolerances(system, 1e-8)
    memory = np.asarray(tolerances.atol)[system.layout.memory_start :][: system.layout.n_memory].reshape(-1, 3)
    position, quaternion = np.asarray(tolerances.atol)[0], np.asarray(tolerances.atol)[3]
    assert np.all(memory[[0, 1, 4]] == position)
    assert np.all(memory[[2, 3, 5]] == quaternion)


def test_a_loaded_start_is_relaxed():
    model = sj.Bushing(law=SPRING, branches=BRANCHES, friction=FRICTION)
    found = sj.equilibrium(pressed(model, 30.0))
    run = sj.simulate(found.scene, np.linspace(0.0, 0.2, 3)).require_success()
    assert np.asarray(run.eccentricity("joint"))[:, 0] == pytest.approx(30.0 / K, rel=1e-6)
    assert np.abs(run.state.memory).max() < 1e-12


# Derivatives ----------------------------------------------------------------------------------------------------------


def test_derivatives_of_a_run_by_stiffness_and_time():
    def end(x):
        branches = sj.laws.Maxwell([x[0], 5e4], [x[1], 0.01])
        model = sj.Bushing(law=SPRING, branches=branches, friction=sj.laws.Berg(x[2], x[3]))
        run = sj.simulate(pressed(model, 30.0), jnp.linspace(0.0, 0.06, 3), rtol=1e-10)
        return run.eccentricity("joint")[-1, 0] * 1e4

    at = np.array([1e5, 0.1, LIMIT, HALF])
    gradient = np.asarray(jax.grad(end)(jnp.asarray(at)))
    end = jax.jit(end)
    for i, seed in enumerate(np.eye(4)):
        forward = jax.jvp(end, (jnp.asarray(at),), (jnp.asarray(seed),))[1]
        assert float(forward) == pytest.approx(gradient[i], rel=1e-6)
        h = 1e-3 * at[i] * seed
        difference = (end(at - 2 * h) - 8 * end(at - h) + 8 * end(at + h) - end(at + 2 * h)) / (12e-3 * at[i])
        assert gradient[i] == pytest.approx(float(difference), rel=1e-5)


def test_branches_are_found_in_a_record_of_creep():
    def build(stiffness, time):
        return pressed(sj.Bushing(law=SPRING, branches=sj.laws.Maxwell(stiffness, time)), 30.0)

    ts = np.linspace(0.0, 0.3, 61)
    exact = linear_motion(ts, (0.0, 0.0), 30.0)[:, 0]
    measured = {"time": ts, "position.ball.x": exact + 1e-7 * np.random.default_rng(0).standard_normal(61)}
    start = {"stiffness": [8e4, 8e4], "time": [0.15, 0.006]}
    fit = sj.fit(build, start, measured, noise=1e-7, progress=False)
    assert fit.succeeded
    assert fit.estimates["stiffness"] == pytest.approx(STIFFNESSES, rel=0.02)
    assert fit.estimates["time"] == pytest.approx(TIMES, rel=0.02)


# Bad input ------------------------------------------------------------------------------------------------------------

BAD = {
    "a negative time": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([1e5], [-0.1])), "branches.time"),
    "no time": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([1e5], [0.0])), "branches.time"),
    "lengths that differ": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([1e5, 1e4], [0.1])), "branches.stiffness"),
    "two along the axes": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([[1e5, 1e4]], [0.1])), "rows of three"),
    "no branches": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([], [])), "list of numbers"),
    "a text": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell("1e5", 0.1)), "stiffness"),
    "a negative stiffness": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([-1e5], [0.1])), "branches.stiffness"),
    "nan": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell([np.nan], [0.1])), "branches.stiffness"),
    "a negative limit": (lambda: sj.Bushing(K, friction=sj.laws.Berg(-1.0, 1e-4)), "friction.limit"),
    "no length": (lambda: sj.Bushing(K, friction=sj.laws.Berg(1.0, 0.0)), "friction.half_length"),
    "two limits": (lambda: sj.Bushing(K, friction=sj.laws.Berg([1.0, 2.0], 1e-4)), "friction.limit"),
    "no moments": (
        lambda: sj.Bushing(K, branches=sj.laws.Maxwell([1.0], [0.1], rotational_stiffness=[1.0])),
        "branches.rotational_stiffness",
    ),
    "a class": (lambda: sj.Bushing(K, branches=sj.laws.Maxwell), "branches"),
    "another part": (lambda: sj.Bushing(K, friction=sj.LuGre()), "friction"),
}


@pytest.mark.parametrize(("make", "named"), BAD.values(), ids=BAD)
def test_bad_input_is_named(make, named):
    with pytest.raises(sj.SceneError, match=rf"joint 'joint'.*{named}"):
        sj.simulate(pressed(make()), [0.0, 1e-3])


def test_what_slides_is_not_held():
    for part in ({"branches": sj.laws.Maxwell([1e3], [0.1])}, {"friction": sj.laws.Berg(1.0, 1e-4)}):
        joint = sj.Cylindrical(
            ("ground", "ball"), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), model=sj.Bushing(law=HINGE, **part)
        )
        scene = sj.Scene({"ball": sj.Body(1.0, (1e-3, 1e-3, 1e-3))}, {"slide": joint})
        with pytest.raises(sj.SceneError, match=r"'slide'.*must be zero where the law has no stiffness"):
            sj.simulate(scene, [0.0, 1e-3])


def test_half_of_rotational_friction_is_refused():
    with pytest.raises(TypeError, match="half_angle"):
        sj.laws.Berg(1.0, 1e-4, rotational_limit=1.0)


def test_bad_traced_numbers_are_that_lane_s_status():
    def end(tau):
        run = sj.simulate(
            pressed(sj.Bushing(K, 0.0, branches=sj.laws.Maxwell([1e5], [tau])), 1.0), [0.0, 1e-3], throw=False
        )
        return run.succeeded, run.eccentricity("joint")[-1, 0]

    succeeded, _ = jax.vmap(end)(jnp.array([0.1, -0.1]))
    assert succeeded.tolist() == [True, False]


# Files ----------------------------------------------------------------------------------------------------------------


def test_rubber_in_a_file_with_units(tmp_path):
    text = """
    [ground_points]
    socket = [0, 0, 0]
    [bodies.ball]
    mass = 2.0
    inertia = [1e-5, 1e-5, 1e-5]
    points.center = [0, 0, 0]
    [joints.joint]
    kind = "spherical"
    socket = "ground.socket"
    ball = "ball.center"
    [joints.joint.model]
    kind = "bushing"
    law = { kind = "vector-elastomer", stiffness = "200 N/mm", damping = 0 }
    branches = { stiffness = ["100 N/mm", 5e4], time = ["100 ms", 0.01] }
    friction = { limit = "0.04 kN", half_length = "0.1 mm" }
    """
    path = tmp_path / "rubber.toml"
    path.write_text(text)
    read = sj.load_scene(path).joints["joint"].model
    assert isinstance(read.branches, sj.laws.Maxwell)
    assert np.asarray(read.branches.stiffness) == pytest.approx(STIFFNESSES)
    assert np.asarray(read.branches.time) == pytest.approx(TIMES)
    assert float(read.friction.limit) == pytest.approx(LIMIT)
    assert read.friction.half_length == pytest.approx(HALF)
    path.write_text(text.replace('"100 ms", 0.01', '"100 ms", "-10 ms"'))
    with pytest.raises(sj.SceneError, match="time"):
        sj.load_scene(path)
