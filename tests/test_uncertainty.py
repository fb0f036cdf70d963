"""Tolerances: samples of distributions, budgets of first order, shares of variances, against closed forms."""

import warnings

import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from scipy import stats

import spherejax as sj

TS = jnp.linspace(0.0, 0.5, 6)
G, END = 9.81, 0.5


def thrown(x=0.0, y=0.0, z=0.0, gravity=G):
    """A body that flies with given velocities: what is observed is a known function of the numbers."""
    return sj.Scene({"ball": sj.Body(1.0, (1e-2,) * 3, velocity=(x, y, z))}, gravity=(0.0, 0.0, -gravity))


def up(speed, gravity):
    return thrown(z=speed, gravity=gravity)


def times(a, b):
    """Flies sideways by a b t, upwards by a t."""
    return thrown(x=a * b, z=a, gravity=0.0)


# Spreads --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draw", [sj.studies.random_samples, sj.studies.sobol_samples])
def test_samples_follow_their_distributions(draw):
    spreads = {
        "part": sj.studies.Tolerance(1e-4, 3e-5),
        "even": sj.studies.Tolerance(1.0, 0.5, "uniform"),
        "range": (2.0, 4.0),
        "skew": stats.gamma(3.0, scale=0.1),
    }
    found = draw(spreads, 4096).values
    for name, spread in spreads.items():
        given = spread.distribution if isinstance(spread, sj.studies.Tolerance) else stats.uniform(2.0, 2.0)
        expected = spread if name == "skew" else given
        assert stats.kstest(found[name], expected.cdf).pvalue > 1e-3
    assert np.max(np.abs(found["part"] - 1e-4)) <= 3e-5  # parts beyond the limits are rejected
    assert stats.truncnorm(-3, 3).std() * 1e-5 == pytest.approx(sj.studies.Tolerance(1e-4, 3e-5).distribution.std())


def test_ranges_give_the_numbers_that_they_always_gave():
    found = sj.studies.random_samples({"a": (0.25, 3.0), "b": (1e-6, 1e-3)}, 50, rng=3, logarithmic=["b"]).values
    points = np.random.default_rng(3).random((50, 2))
    np.testing.assert_array_equal(found["a"], 0.25 + points[:, 0] * (3.0 - 0.25))
    np.testing.assert_array_equal(found["b"], np.exp(np.log(1e-6) + points[:, 1] * np.log(1e-3 / 1e-6)))


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda: sj.studies.Tolerance(1.0, 0.0), "half_width = 0 must be positive"),
        (lambda: sj.studies.Tolerance(np.nan, 1.0), "nominal = nan must be a finite number"),
        (lambda: sj.studies.Tolerance(1.0, 0.1, "flat"), "'normal' or 'uniform'"),
        (lambda: sj.studies.random_samples({"a": 3.0}, 4), "needs a range .* sj.studies.Tolerance"),
        (lambda: sj.studies.random_samples({"a": stats.cauchy()}, 4), "finite mean and standard deviation"),
        (lambda: sj.studies.random_samples({"a": stats.norm([1, 2], 1)}, 4), "of one number"),
        (
            lambda: sj.studies.random_samples({"a": sj.studies.Tolerance(1.0, 0.1)}, 4, logarithmic=["a"]),
            "is for ranges",
        ),
        (
            lambda: sj.studies.sobol_indices(up, {"speed": (0, 1), "gravity": (9, 10)}, TS, record=[], n=24),
            "power of two",
        ),
        (
            lambda: sj.studies.sobol_indices(up, {}, TS, record=["final position.ball"]),
            "needs uncertain numbers by name",
        ),
        (lambda: sj.monte_carlo(up, {"speed": (0, 1)}, TS, record=["final position.ball"], n=1), "n = 1"),
        (lambda: sj.monte_carlo(up, {"speed": "fast"}, TS, record=["final position.ball"]), "needs a range"),
        (lambda: sj.studies.tolerance_budget(up, {"speed": (0, 1), "gravity": (9, 10)}, TS), "observables="),
        (lambda: sj.studies.tolerance_budget(up, {"sped": (0, 1)}, TS, of=lambda run: run.ts[-1]), "cannot be called"),
    ],
)
def test_what_makes_no_sense_is_refused(ask, words):
    with pytest.raises(sj.SceneError, match=words):
        ask()


# First order ----------------------------------------------------------------------------------------------------------

FLIGHT = {"speed": sj.studies.Tolerance(5.0, 0.3), "gravity": (G - 0.1, G + 0.1)}


@pytest.fixture(scope="module")
def budget():
    with warnings.catch_warnings():
        warnings.simplefilter("error", sj.errors.UncertaintyWarning)
        return sj.studies.tolerance_budget(up, FLIGHT, TS, observables=["position.ball"])


def test_a_budget_of_a_linear_motion_is_exact(budget):
    """z = v t - g t^2 / 2."""
    part, t = budget.of("position.ball"), np.asarray(TS)
    deviations = np.array([sj.studies.Tolerance(5.0, 0.3).distribution.std(), 0.2 / np.sqrt(12)])
    effects = np.stack([t * deviations[0], -(t**2) / 2 * deviations[1]], 1)
    np.testing.assert_allclose(part.effects[:, 2], effects, rtol=0, atol=1e-10)
    np.testing.assert_allclose(part.deviation[:, 2], np.linalg.norm(effects, axis=1), rtol=0, atol=1e-10)
    np.testing.assert_allclose(part.worst[:, 2], 0.3 * t + 0.1 * t**2 / 2, rtol=0, atol=1e-10)
    np.testing.assert_allclose(part.shares[1:].sum(-1)[:, 2], 1.0, rtol=1e-12)
    assert np.all(part.shares[0] == 0)  # nothing scatters at the start
    assert part.bent < 1e-6


def test_a_budget_is_told_tabled_and_drawn(budget, tmp_path):
    text = str(budget)
    assert [line.split()[:3] for line in text.splitlines()[2:4]] == [["speed", "5", "0.3"], ["gravity", "9.81", "0.1"]]
    assert "position.ball.z" in text
    assert "position.ball.x" not in text  # it does not scatter
    assert "first order holds to better than 0.0001 %" in text
    data = budget.to_xarray()
    z = data["deviation.position.ball"].sel(axis="z").values
    np.testing.assert_array_equal(z, budget.of("position.ball").deviation[:, 2])
    assert data["share.position.ball"].sel(parameter="speed", axis="z").values[-1] > 0.9
    for engine in ("h5netcdf", "scipy"):
        data.to_netcdf(tmp_path / f"{engine}.nc", engine=engine)
        assert xarray.open_dataset(tmp_path / f"{engine}.nc").attrs["derivative_mode"] == "forward"
    figures = budget.figures()
    assert set(figures) == {"position.ball", "shares"}
    bars = figures["shares"].axes[0].patches
    assert sum(bar.get_width() for bar in bars) == pytest.approx(100.0)
    with pytest.raises(KeyError, match="was not asked for"):
        budget.of("velocity.ball")


def test_a_budget_that_bends_says_so():
    """x = a^2 t about a = 0.1 +- 0.3: half of what a makes is of second order."""

    def sideways(run):
        return run.position("ball")[-1, 0]

    with pytest.warns(sj.errors.UncertaintyWarning, match="sideways by 49 %.*sj.studies.sobol_indices"):
        found = sj.studies.tolerance_budget(
            lambda a: times(a, a), {"a": sj.studies.Tolerance(0.1, 0.3)}, TS, of=sideways
        )
    deviation = sj.studies.Tolerance(0.1, 0.3).distribution.std()
    (part,) = found.parts
    assert part.deviation[0, 0] == pytest.approx(2 * 0.1 * deviation * END, rel=1e-8)
    assert part.bent == pytest.approx(deviation / (2 * 0.1), rel=1e-6)


def test_a_budget_at_a_best_point_says_that_it_misses_everything():
    """x = a^2 t about a = 0: the derivative vanishes, the scatter does not."""
    with pytest.warns(sj.errors.UncertaintyWarning, match="position.ball.x by many times"):
        found = sj.studies.tolerance_budget(
            lambda a: times(a, a), {"a": sj.studies.Tolerance(0.0, 0.3)}, TS, observables=["position.ball.x"]
        )
    np.testing.assert_allclose(found.parts[0].deviation, 0.0, atol=1e-15)


def test_a_budget_of_a_number_near_its_limit_does_not_step_over_it():
    """A gamma distribution whose mean is less than a deviation above zero."""
    skew = stats.gamma(0.5, scale=0.2)
    assert skew.std() > skew.mean()

    def build(a):
        return thrown(z=jnp.where(a < 0, jnp.nan, a))

    found = sj.studies.tolerance_budget(build, {"a": skew}, TS, observables=["position.ball.z"])
    assert found.parts[0].bent < 1e-6


def test_a_budget_of_a_run_that_stops_early_says_so():
    with pytest.warns(sj.errors.UncertaintyWarning, match="all numbers at their middle stopped early"):
        found = sj.studies.tolerance_budget(
            sprung, {"stiffness": (3.9e4, 4e4)}, TS, observables="position.ball", max_steps=60, check=False
        )
    assert "stopped early" in str(found)


def test_each_observable_is_checked_by_its_own_runs():
    """z = a t is straight, x = a^2 t is not, in whichever order they are asked for."""

    def straight(run):
        return run.position("ball")[:, 2]

    with pytest.warns(sj.errors.UncertaintyWarning, match="deviation: position.ball.x by 49 %. Take"):
        found = sj.studies.tolerance_budget(
            lambda a: times(a, a), {"a": sj.studies.Tolerance(0.1, 0.3)}, TS, observables=[straight, "position.ball.x"]
        )
    assert found.of("straight").bent < 1e-6
    assert found.of("position.ball.x").bent > 0.4


def sprung(stiffness):
    """A body between elastic walls; stiff ones take more steps than there are."""
    spring = sj.SpringDamper(("ground.wall", "ball"), stiffness, direction=(1.0, 0.0, 0.0))
    body = sj.Body(1.0, (1e-2,) * 3, position=(0.2, 0.0, 0.0))
    return sj.Scene({"ball": body}, forces={"spring": spring}, ground_points={"wall": (0.0, 0.0, 0.0)})


STIFF = {"stiffness": (10.0, 8e3)}


def test_a_budget_whose_check_fails_says_so():
    with pytest.warns(sj.errors.UncertaintyWarning, match="at one deviation aside failed"):
        sj.studies.tolerance_budget(sprung, {"stiffness": (1.0, 9e3)}, TS, observables="position.ball", max_steps=60)


# Shares of the variance -----------------------------------------------------------------------------------------------


def flight(p, q, r, speed, gravity, a, b):
    """x: Ishigami's function; y: thrown against gravity; z: a product."""
    x = jnp.sin(p) + 7 * jnp.sin(q) ** 2 + 0.1 * r**4 * jnp.sin(p)
    ball = sj.Body(1.0, (1e-2,) * 3, velocity=(x, speed, a * b))
    return sj.Scene({"ball": ball}, gravity=(0.0, -gravity, 0.0))


SCATTER = {
    **dict.fromkeys("pqr", (-np.pi, np.pi)),
    "speed": stats.norm(5.0, 0.1),
    "gravity": stats.norm(G, 1.0),
    "a": stats.norm(3.0, 0.5),
    "b": (1.0, 3.0),
}


@pytest.fixture(scope="module")
def indices():
    wanted = ["final position.ball", "position.ball.y"]
    return sj.studies.sobol_indices(flight, SCATTER, TS, record=wanted, n=1024, progress=False)


def test_indices_of_ishigamis_function(indices):
    """Ishigami and Homma (1990), a = 7, b = 0.1."""
    shares = indices.of("final_position.ball")
    np.testing.assert_allclose(shares.first[0], [0.3139, 0.4424, 0.0, 0.0, 0.0, 0.0, 0.0], atol=0.03)
    np.testing.assert_allclose(shares.total[0], [0.5576, 0.4424, 0.2437, 0.0, 0.0, 0.0, 0.0], atol=0.03)


def test_indices_of_a_product(indices):
    va, vb, shares = 0.25, 4 / 12, indices.of("final_position.ball")
    variance = 4 * va + 9 * vb + va * vb
    for expected, seen, error in (
        (np.array([4 * va, 9 * vb]) / variance, shares.first[2, 5:], shares.first_error[2, 5:]),
        (np.array([4 * va + va * vb, 9 * vb + va * vb]) / variance, shares.total[2, 5:], shares.total_error[2, 5:]),
    ):
        assert np.all(np.abs(seen - expected) < np.maximum(4 * error, 0.01))
        assert np.all(error < 0.06)
    assert shares.deviation[2] == pytest.approx(END * np.sqrt(variance), rel=0.05)


def test_indices_along_time(indices):
    """The share of v in v t - g t^2 / 2 falls as time goes on."""
    t, shares = np.asarray(TS)[1:], indices.of("position.ball.y")
    of_speed = (0.1 * t) ** 2 / ((0.1 * t) ** 2 + (t**2 / 2) ** 2)
    np.testing.assert_allclose(shares.total[1:, 3], of_speed, atol=0.05)
    np.testing.assert_allclose(shares.total[1:, 4], 1 - of_speed, atol=0.05)
    np.testing.assert_array_equal(shares.total[0], 0.0)  # at the start nothing varies


def test_indices_are_told_tabled_and_drawn(indices):
    data = indices.to_xarray()
    assert data["first.final_position.ball"].dims == ("axis", "parameter")
    assert data["total.position.ball.y"].dims == ("time", "parameter")
    of_z = data["total.final_position.ball.error"].sel(axis="z", parameter="b")
    assert float(of_z) == indices.of("final_position.ball").total_error[2, 6]
    assert "final_position.ball.x" in str(indices)
    figures = indices.figures()
    assert len(figures["position.ball.y"].axes) == 2
    assert len([ax for ax in figures["final_position.ball"].axes if ax.get_visible()]) == 3
    with pytest.raises(KeyError, match="was not kept"):
        indices.of("final_velocity.ball")


def test_indices_leave_out_what_failed_and_say_so():
    with pytest.warns(sj.errors.UncertaintyWarning, match=r"sobol_indices: \d+ of 96 runs failed.*too_many_steps"):
        found = sj.studies.sobol_indices(
            sprung, STIFF, TS, record=["final position.ball"], n=32, max_steps=60, progress=False
        )
    assert " of 32 base samples have no failed run" in found.note
    assert np.all(np.isfinite(found.shares[0].total))


# Monte Carlo ----------------------------------------------------------------------------------------------------------


def test_the_scatter_of_samples_is_that_of_the_budget(budget):
    found = sj.monte_carlo(up, FLIGHT, TS, record=["final position.ball", "position.ball.z"], n=2000, progress=False)
    expected = budget.of("position.ball").deviation[-1, 2]
    z = {"axis": "z"}
    assert float(found.deviation["final_position.ball"].sel(z)) == pytest.approx(expected, rel=0.06)
    mean, error = (each["final_position.ball"].sel(z) for each in (found.mean, found.error_of_mean))
    assert abs(float(mean) - (5.0 * END - G * END**2 / 2)) < 4 * float(error)
    low, high = found.quantile([0.025, 0.975])["final_position.ball"].sel(z).values
    assert low < float(mean) < high
    assert "Scatter of 2000 runs" in str(found)
    figures = found.figures()
    assert set(figures) == {"final_position.ball", "position.ball.z"}
    assert figures["final_position.ball"].axes[0].patches


def test_samples_that_fail_are_left_out_and_told():
    with pytest.warns(sj.errors.UncertaintyWarning, match=r"monte_carlo: \d+ of 40 runs failed.*stiffness = "):
        found = sj.monte_carlo(sprung, STIFF, TS, record=["final position.ball"], n=40, max_steps=60, progress=False)
    assert 2 <= found.is_used.sum() < 40
    assert np.all(np.isfinite(found.mean["final_position.ball"]))
    assert f"{found.is_used.sum()} of 40 runs are left" in str(found)


def test_samples_that_all_fail_are_an_error():
    with pytest.raises(sj.SceneError, match="8 of 8 runs failed"):
        sj.monte_carlo(sprung, STIFF, TS, record=["final position.ball"], n=8, max_steps=2, progress=False)


def test_a_store_keeps_the_runs(tmp_path):
    ask = dict(record=["final position.ball"], n=8, store=tmp_path / "s.zarr", progress=False)
    first = sj.studies.sobol_indices(up, FLIGHT, TS, **ask)
    again = sj.studies.sobol_indices(up, FLIGHT, TS, **ask)
    np.testing.assert_array_equal(first.shares[0].total, again.shares[0].total)
    assert sj.open_sweep(tmp_path / "s.zarr").sizes["run"] == 8 * 4
