"""Cycles: shooting, multipliers, continuation and swept sine against SciPy, closed forms and hand-written equations."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
import scipy.special

import spherejax as sj
from spherejax import cli

X = (1.0, 0.0, 0.0)
Y = (0.0, 1.0, 0.0)


class Push(eqx.Module):
    """A harmonic force along x."""

    force: float
    frequency: float

    def __call__(self, t):
        return self.force * jnp.cos(2 * jnp.pi * self.frequency * t) * jnp.array(X)


DAMPING, CUBIC = 0.2, 1.0


def duffing(frequency=0.1, force=0.3):
    """x'' + 0.2 x' + x + x^3 = F cos(w t): a body on a guide."""
    body = sj.Body(1.0, (2.0, 2.0, 2.0), points={"center": (0.0, 0.0, 0.0)})
    spring = sj.SpringDamper(
        ("ground.wall", "body.center"),
        1.0,
        DAMPING,
        spring=sj.functions.Polynomial([0.0, 0.0, 0.0, CUBIC]),
        direction=X,
    )
    return sj.Scene(
        {"body": body},
        {"guide": sj.Prismatic(("ground", "body"), (0.0, 0.0, 0.0), X)},
        {"spring": spring, "push": sj.AppliedWrench("body", force=Push(force, frequency))},
        gravity=(0.0, 0.0, 0.0),
        ground_points={"wall": (0.0, 0.0, 0.0)},
    )


def shot(x, frequency, force, span):
    """SciPy's flow of the oscillator with its derivative: x, v, and the fundamental matrix."""

    def rate(t, y):
        x, v = y[:2]
        push = force * np.cos(2 * np.pi * frequency * t)
        J = np.array([[0.0, 1.0], [-1.0 - 3 * CUBIC * x * x, -DAMPING]])
        return [v, push - DAMPING * v - x - CUBIC * x**3, *(J @ y[2:].reshape(2, 2)).ravel()]

    found = scipy.integrate.solve_ivp(rate, (0.0, span), [*x, 1.0, 0.0, 0.0, 1.0], rtol=1e-11, atol=1e-12)
    return found.y[:2, -1], found.y[2:, -1].reshape(2, 2)


def reference(x, frequency, force):
    """The cycle near a state, and its multipliers, by Newton's method on SciPy's flow."""
    x = np.array(x)
    for _ in range(20):
        end, M = shot(x, frequency, force, 1 / frequency)
        step = np.linalg.solve(M - np.eye(2), x - end)
        x = x + step
        if np.abs(step).max() < 1e-12:
            return x, np.linalg.eigvals(shot(x, frequency, force, 1 / frequency)[1])
    raise AssertionError("no reference")


@pytest.fixture(scope="module")
def branch():
    return sj.studies.continuation(
        duffing,
        "frequency",
        (0.17, 0.25),
        period=lambda frequency: 1 / frequency,
        outputs="position.body.x",
        first_step=0.1,
        largest_step=0.5,
        samples=64,
    )


def sorted_by_size(values):
    return values[np.lexsort((values.imag, np.abs(values)))]


def test_a_branch_goes_round_its_folds(branch):
    """Every point is a cycle of SciPy's equation with the same multipliers, the unstable ones too."""
    assert branch.succeeded, branch.diagnosis
    np.testing.assert_allclose(branch.values[[0, -1]], [0.17, 0.25], rtol=1e-12)
    assert [event.kind for event in branch.events] == ["fold", "fold"]
    assert [event.becomes_stable for event in branch.events] == [False, True]
    assert set(branch.is_stable) == {True, False}
    assert not np.any(np.diff(branch.is_stable.astype(int)).nonzero()[0] == len(branch) - 2)
    chosen = [0, *np.flatnonzero(~branch.is_stable)[:2], len(branch) - 1]
    for k in chosen:
        place = branch.points[k].shot.place
        start = [place.y[0], place.y[7]]
        x, mu = reference(start, branch.values[k], 0.3)
        np.testing.assert_allclose(start, x, atol=3e-7)
        found = branch.points[k].multipliers.values
        np.testing.assert_allclose(sorted_by_size(found), sorted_by_size(mu), atol=3e-6)
        # The product of the multipliers is exp(-damping T), whatever the cycle.
        assert np.prod(found).real == pytest.approx(np.exp(-DAMPING / branch.values[k]), rel=1e-6)


def fold_of_scipy(x, frequency):
    """State and frequency at which a multiplier is 1, by the secant rule on det(M - 1)."""

    def closing(unknown):
        end, M = shot(unknown[:2], unknown[2], 0.3, 1 / unknown[2])
        return [*(end - unknown[:2]), np.linalg.det(M - np.eye(2))]

    return scipy.optimize.fsolve(closing, [*x, frequency], xtol=1e-12)


def test_folds_are_where_a_multiplier_is_one(branch):
    for fold in branch.folds:
        y = fold.point.shot.place.y
        assert fold.value == pytest.approx(fold_of_scipy([y[0], y[7]], fold.value)[2], rel=2e-7)


def test_a_branch_as_a_table(branch, tmp_path):
    table = branch.to_xarray()
    x = "position.body.x"
    assert table[f"{x}.amplitude"].attrs["units"] == "m"
    np.testing.assert_array_equal(np.asarray(table["stable"], bool), branch.is_stable)
    # An even force law: no mean, and the third harmonic is all that distorts.
    np.testing.assert_allclose(table[f"{x}.mean"], 0.0, atol=1e-9)
    assert 0.001 < float(table[f"{x}.distortion"].max()) < 0.05
    table.to_netcdf(tmp_path / "branch.nc")
    assert "fold at 0.2202" in str(branch)
    figure = branch.figure()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["stable", "unstable", "fold"]
    # A line changes its look where a multiplier is 1, not at the next cycle behind it.
    for line in figure.axes[1].lines[:3]:
        sizes = np.asarray(line.get_ydata())
        is_dashed = line.get_linestyle() == "--"
        assert np.all(sizes > 1 - 1e-3) if is_dashed else np.all(sizes < 1 + 1e-3), sizes
    with pytest.raises(sj.SceneError, match=r"did not keep 'position\.body\.y'"):
        branch.figure("position.body.y")
    with pytest.raises(sj.SceneError, match="no point 1000"):
        branch.cycle(1000)


def test_a_point_of_a_branch_is_a_cycle(branch):
    """An unstable one: its own motion, as a run, closes."""
    k = int(np.flatnonzero(~branch.is_stable)[0])
    cycle = branch.cycle(k)
    assert cycle.succeeded
    assert not cycle.is_stable
    assert "unstable: a deviation grows to one side" in str(cycle)
    x = np.asarray(cycle.run.position("body"))[:, 0]
    assert abs(x[-1] - x[0]) < 1e-6
    c = cycle.harmonics("position.body.x", 3)
    assert abs(c[1].item()) == pytest.approx(float(branch.to_xarray()["position.body.x.amplitude"][k]), rel=1e-4)
    drawn = cycle.figure("position.body.x", "velocity.body.x")
    assert len(drawn.axes) == 2


def test_a_period_that_is_none_is_found_out():
    """The force has 10 s; a motion that is the same after 7 s is none of it."""
    with pytest.warns(sj.errors.CycleWarning, match=r"does not repeat itself after 7 s"):
        cycle = sj.steady_cycle(duffing(0.1), period=7.0)
    assert not cycle.succeeded
    assert str(cycle).startswith("no cycle:")
    with pytest.raises(sj.SimulationError, match="does not repeat itself"):
        cycle.require_success()
    with pytest.raises(sj.SceneError, match="something depends on time"):
        sj.steady_cycle(duffing(0.1), near=7.0)


# Without a driver --------------------------------------------------------------------------------------------------


class VanDerPol(eqx.Module):
    """Everything of x'' - mu (1 - x^2) x' + x = 0 but the inertia."""

    mu: float

    def __call__(self, t, motions):
        del t
        x, v = motions["body"].position[0], motions["body"].velocity[0]
        return (self.mu * (1 - x * x) * v - x) * jnp.array(X)


def van_der_pol_of_scipy(mu):
    """Period and the multiplier that is not 1: the exponential of the divergence over a period."""

    def rate(t, y):
        return [y[1], mu * (1 - y[0] ** 2) * y[1] - y[0], mu * (1 - y[0] ** 2)]

    def crosses(t, y):
        return y[1]

    crosses.direction = -1
    found = scipy.integrate.solve_ivp(rate, (0.0, 80.0), [2.0, 0.0, 0.0], rtol=1e-11, atol=1e-12, events=crosses)
    (first, second), states = found.t_events[0][-2:], found.y_events[0][-2:]
    return second - first, np.exp(states[1][2] - states[0][2])


@pytest.mark.slow
def test_an_oscillator_that_drives_itself():
    body = sj.Body(1.0, (2.0, 2.0, 2.0), (1.5, 0.0, 0.0))
    scene = sj.Scene(
        {"body": body},
        {"guide": sj.Prismatic(("ground", "body"), (1.5, 0.0, 0.0), X)},
        {"pump": sj.AppliedWrench("body", force=VanDerPol(1.0))},
        gravity=(0.0, 0.0, 0.0),
    )
    cycle = sj.steady_cycle(scene, near=6.0)
    period, multiplier = van_der_pol_of_scipy(1.0)
    assert cycle.period == pytest.approx(period, rel=1e-7)
    assert cycle.is_stable
    np.testing.assert_allclose(np.sort(np.abs(cycle.multipliers.values)), [multiplier, 1.0], atol=1e-6)
    np.testing.assert_array_equal(cycle.multipliers.is_free, [True, False])


def pendulum(angle, **motion):
    turned = (np.cos(angle / 2), 0.0, -np.sin(angle / 2), 0.0)
    place = (0.5 * np.sin(angle), 0.0, -0.5 * np.cos(angle))
    body = sj.Body(1.0, (2e-2, 1e-2, 1.5e-2), place, turned, points={"center": (0.0, 0.0, 0.0)}, **motion)
    return sj.Scene({"bob": body}, {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)})


@pytest.mark.slow
def test_a_pendulum_swings_slower_the_wider_it_swings():
    """T = 4 K(sin^2(a/2)) / w0, of any cycle of the family that is found; both multipliers are 1."""
    cycle = sj.steady_cycle(pendulum(1.5), near=1.5)
    run = cycle.run
    energy = float(np.asarray(run.mechanical_energy)[0])
    widest = np.arccos(-energy / (9.81 * 0.5))
    w0 = np.sqrt(9.81 * 0.5 / (1e-2 + 0.25))
    assert cycle.period == pytest.approx(4 / w0 * scipy.special.ellipk(np.sin(widest / 2) ** 2), rel=1e-7)
    assert 1.2 < widest < 1.7
    assert "neutral" in str(cycle)
    with pytest.warns(sj.errors.CycleWarning, match="rests there"):
        assert not sj.steady_cycle(pendulum(0.0), near=1.5).succeeded


# Mechanisms --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_multipliers_from_disturbed_starts_are_as_good_as_they_say():
    """By a stiff method: the product is that of the damping, to no more than twice the error that is told."""
    cycle = sj.steady_cycle(duffing(0.25), period=4.0, settle=5, solver=sj.solvers.Rodas5P())
    assert cycle.succeeded, cycle.diagnosis
    assert 0 < cycle.multipliers.doubt < 3e-6
    assert abs(np.prod(cycle.multipliers.values) - np.exp(-DAMPING * 4.0)) < 2 * cycle.multipliers.doubt
    assert "from disturbed starts" in str(cycle)


@pytest.mark.slow
def test_a_path_of_a_scene_is_a_number_too():
    """The same branch along the cubic stiffness, by its path."""
    branch = sj.studies.continuation(
        duffing(0.25), "forces.spring.damping", (0.2, 0.4), period=4.0, first_step=0.5, largest_step=1.0
    )
    assert branch.succeeded
    for k in (0, -1):
        found = np.prod(branch.points[k].multipliers.values).real
        assert found == pytest.approx(np.exp(-branch.values[k] * 4.0), rel=1e-6)


# Impacts -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stop_in_a_cycle():
    """A driven oscillator that strikes a linear stop: a cycle through its touches, with SciPy's multipliers."""

    def hit(frequency, force):
        scene = duffing(frequency, force)
        stop = sj.forces.BumpStop(("ground.wall", "body.center"), longest=0.2, stiffness=50.0, direction=X)
        return eqx.tree_at(lambda s: s.forces, scene, {**scene.forces, "stop": stop})

    cycle = sj.steady_cycle(hit(0.25, 0.4), period=4.0, settle=30)
    assert cycle.succeeded, cycle.diagnosis
    x = np.asarray(cycle.run.position("body"))[:, 0]
    assert x.max() > 0.2 or x.min() < -0.2
    assert np.prod(cycle.multipliers.values).real == pytest.approx(np.exp(-DAMPING * 4.0), rel=1e-4)


# Swept sine --------------------------------------------------------------------------------------------------------


def on_rubber():
    """An arm whose end is in a bushing."""
    law = sj.laws.MatrixElastomer(
        np.diag([1e4, 2e4, 3e4]), np.diag([10.0, 20.0, 30.0]), np.diag([60.0, 80.0, 90.0]), np.diag([0.1, 0.1, 0.1])
    )
    arm = sj.Body(2.0, (1e-2, 2e-2, 2.5e-2), (0.1, 0.0, 0.0), points={"ball": (-0.1, 0.0, 0.0)})
    return sj.Scene(
        {"arm": arm},
        {"mount": sj.Spherical("ground.socket", "arm.ball", sj.Bushing(law=law))},
        {"push": sj.AppliedWrench("arm")},
        ground_points={"socket": (0.0, 0.0, 0.0)},
    )


@pytest.mark.slow
def test_small_answers_are_the_linear_ones():
    """To 1e-4 for a hundredth of a newton, each output at each frequency; larger ones depart, and are distorted."""
    found = sj.studies.swept_sine(
        on_rubber(), "forces.push.force.z", ["position.arm.z", "reaction.mount.z"], [2.0, 6.0, 9.0, 25.0], [1e-2, 30.0]
    )
    assert found.succeeded.all()
    assert found.is_stable.all()
    assert found.departure[0].max() < 1e-4
    assert found.departure[1].max() > 1e-3
    assert np.all(found.distortion[1, 1:3, 0] > found.distortion[0, 1:3, 0])
    table = found.to_xarray()
    assert table["distortion"].dims == ("amplitude", "frequency", "output")
    assert len(found.figure("reaction.mount.z").axes) == 3
    assert "2 amplitudes; 8 of 8 cycles found" in str(found)


def resting_duffing():
    scene = duffing()
    return eqx.tree_at(lambda s: s.forces, scene, {**scene.forces, "push": sj.AppliedWrench("body")})


@pytest.mark.slow
def test_a_sweep_jumps_where_its_branch_folds(branch):
    """Up it stays on the upper branch until the fold at 0.2202 Hz, down on the lower one until that at 0.2074 Hz."""
    frequencies = [0.17, 0.19, 0.205, 0.212, 0.218, 0.223, 0.24]
    sizes = {}
    for sweep in ("up", "down"):
        found = sj.studies.swept_sine(
            resting_duffing(), "forces.push.force.x", "position.body.x", frequencies, 0.3, sweep=sweep, settle=15
        )
        assert found.is_stable.all()
        sizes[sweep] = 0.3 * np.abs(found.response[0, :, 0])
    apart = sizes["up"] - sizes["down"]
    np.testing.assert_allclose(apart[[0, 1, 2, 5, 6]], 0.0, atol=1e-6)
    assert np.all(apart[[3, 4]] > 0.3)
    # On the upper branch SciPy's cycle, from the branch's widest point.
    widest = int(np.argmax(np.asarray(branch.to_xarray()["position.body.x.amplitude"])))
    y = branch.points[widest].shot.place.y
    x, _ = reference([y[0], y[7]], 0.218, 0.3)
    times = np.linspace(0.0, 1 / 0.218, 65)
    seen = np.array([shot(x, 0.218, 0.3, t)[0][0] if t else x[0] for t in times[:-1]])
    first = 2 * abs(np.mean(seen * np.exp(-2j * np.pi * np.arange(64) / 64)))
    assert sizes["up"][4] == pytest.approx(first, rel=1e-6)


@pytest.mark.slow
def test_a_driven_pendulum_softens():
    """Gravity is shaken sideways: in the small the closed form, in the large SciPy's steady swing, distorted."""
    bob = sj.Body(1.0, (2e-2, 1e-2, 1.5e-2), (0.0, 0.0, -0.5))
    scene = sj.Scene(
        {"bob": bob},
        {"pivot": sj.Revolute(("ground", "bob"), (0.0, 0.0, 0.0), Y)},
        {"drag": sj.TorsionalSpring(("ground", "bob"), Y, 0.0, 0.1)},
    )
    found = sj.studies.swept_sine(scene, "gravity.x", "position.bob.x", 0.4, [1e-3, 3.0], settle=3, samples=32)
    J, w = 1e-2 + 0.25, 2 * np.pi * 0.4
    linear = 0.25 / (0.5 * 9.81 + 0.1j * w - J * w * w)
    assert found.response[0, 0, 0] == pytest.approx(linear, rel=1e-5)
    assert found.departure[0, 0, 0] < 1e-5

    def rate(t, y):
        sideways = 3.0 * np.sin(w * t)
        return [y[1], (0.5 * (sideways * np.cos(y[0]) - 9.81 * np.sin(y[0])) - 0.1 * y[1]) / J]

    n = 64
    times = np.linspace(60 / 0.4, 61 / 0.4, n + 1)
    seen = scipy.integrate.solve_ivp(rate, (0.0, times[-1]), [0.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-12)
    first = 2 / n * np.sum(0.5 * np.sin(seen.y[0, :-1]) * np.exp(-2j * np.pi * np.arange(n) / n)) / -3j
    assert found.response[1, 0, 0] == pytest.approx(first, rel=1e-5)
    assert found.distortion[1, 0, 0] > 1e-3


# Requests ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (lambda: sj.steady_cycle(duffing()), "needs period="),
        (lambda: sj.steady_cycle(duffing(), period=1.0, near=1.0), "one of both"),
        (lambda: sj.steady_cycle(duffing(), period=-1.0), "period = -1.0 must be a positive time"),
        (lambda: sj.steady_cycle(duffing(), period=1.0, at="end"), "at='end'"),
        (lambda: sj.steady_cycle(duffing(), period=1.0, settle=-1), "settle = -1"),
        (lambda: sj.steady_cycle(duffing(), period=1.0, samples=4), "too few"),
        (lambda: sj.steady_cycle("duffing", period=1.0), "no scene and no run"),
        (lambda: sj.studies.continuation(duffing, "frequency", (0.1, 0.1), period=1.0), "two different"),
        (
            lambda: sj.studies.continuation(duffing, "freqency", (0.1, 0.2), period=1.0),
            "cannot be called with freqency",
        ),
        (
            lambda: sj.studies.continuation(duffing(), "forces.sprng.stiffness", (1, 2), period=1.0),
            "did you mean 'spring'",
        ),
        (lambda: sj.studies.continuation(duffing, "frequency", (0.1, 0.2), period=lambda f: -f), "must be positive"),
        (
            lambda: sj.studies.continuation(duffing, "frequency", (0.1, 0.2), period=1.0, first_step=2.0),
            "first_step = 2.0",
        ),
        (
            lambda: sj.studies.continuation(duffing, "frequency", (0.1, 0.2), period=1.0, outputs="position.body"),
            "is a vector; name one component",
        ),
        (lambda: sj.studies.swept_sine(on_rubber(), "forces.push.force", "position.arm.z", 1.0, 1.0), "is 3 numbers"),
        (lambda: sj.studies.swept_sine(on_rubber(), "bodies.arm.mass", "position.arm.z", 1.0, 1.0), "cannot be shaken"),
        (lambda: sj.studies.swept_sine(on_rubber(), "gravity.z", "position.arm.z", [1.0, -1.0], 1.0), "frequencies = "),
        (
            lambda: sj.studies.swept_sine(on_rubber(), "gravity.z", "position.arm.z", 1.0, 1.0, sweep="left"),
            "sweep='left'",
        ),
    ],
)
def test_what_makes_no_sense_is_refused(request_, words):
    with pytest.raises(sj.SceneError, match=words):
        request_()


def test_an_element_that_samples_is_refused():
    """Its count of samples does not repeat itself; without a word its samples would not be taken."""
    ball = sj.Body(1.0, (1e-3, 1e-3, 1e-3), position=(0.0, 0.0, 0.3))
    held = sj.forces.SampledPID(sj.Travel(("ground", "ball"), (0.0, 0.0, 1.0)), 0.05, 0.1, 20.0)
    scene = sj.Scene({"ball": ball}, forces={"held": held})
    with pytest.raises(sj.SceneError, match=r"force 'held' samples.*sj\.PID"):
        sj.steady_cycle(scene, period=1.0)


# The command -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command(tmp_path, capsys):
    """A mechanism that a motor turns has no freedom left: a cycle without multipliers."""
    out = tmp_path / "cycle"
    words = ["cycle", "piston", "--period", "0.012", "--settle", "0", "--plot", "position.piston.x", "--out", str(out)]
    assert cli.main(words) == 0
    assert "Cycle of 0.012 s (83.3333 Hz), driven" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {"cycle.nc", "cycle.png", "multipliers.csv", "harmonics.csv"}
    rows = np.loadtxt(out / "harmonics.csv", delimiter=",", skiprows=1)
    # x = r cos a + sqrt(l^2 - r^2 sin^2 a): its first harmonic is the crank's.
    crank = np.asarray(sj.gallery.piston().bodies["crank"].position)[0] * 2
    assert rows[1, 1] == pytest.approx(crank, rel=1e-6)
    assert cli.main(words) == 2
    assert "exists" in capsys.readouterr().err
    assert cli.main([*words, "--overwrite", "--plot", "position.piston"]) == 2
    assert "is a vector" in capsys.readouterr().err
    assert cli.main(["cycle", "piston", "--period", "0.01", "--settle", "0"]) == 3
    assert "does not repeat itself after 0.01 s" in capsys.readouterr().err
