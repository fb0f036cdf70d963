"""Posteriors: a mass on a bushing, whose motion has a closed form, against quadrature and against the fit."""

import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import spherejax as sj
from spherejax.studies.bayes import LogNormal, LogUniform, Normal, Uniform
from spherejax.studies.bayes.density import log_density_of, log_volume, priors_for
from spherejax.studies.bayes.sampling import whitening
from spherejax.studies.fit import problem_of
from spherejax.studies.fit.parameters import unknowns_from

MASS, SPEED, STIFFNESS, DAMPING = 2.0, 1.0, 2e4, 1e-3
TS = np.linspace(1e-3, 0.05, 50)


def mount(stiffness, damping):
    """A mass [kg] that arrives on an elastomer, f = k (e + b e_dot)."""
    body = sj.Body(MASS, (1e-2,) * 3, velocity=(SPEED, 0.0, 0.0), points={"ball": (0.0, 0.0, 0.0)})
    model = sj.Bushing(law=sj.laws.VectorElastomer(stiffness, damping))
    joint = sj.Spherical("ground.socket", "mass.ball", model, starts_concentric=False)
    points = {"socket": (0.0, 0.0, 0.0)}
    return sj.Scene({"mass": body}, {"mount": joint}, ground_points=points, gravity=(0.0, 0.0, 0.0))


def motion(stiffness, damping):
    """The way of the mass at `TS`, in closed form; axes of the parameters first."""
    stiffness, damping = np.asarray(stiffness)[..., None], np.asarray(damping)[..., None]
    frequency = np.sqrt(stiffness / MASS)
    ratio = damping * frequency / 2
    damped = frequency * np.sqrt(1 - ratio**2)
    return SPEED * np.exp(-ratio * frequency * TS) * np.sin(damped * TS) / damped


def measured(noise, seed=0):
    values = motion(STIFFNESS, DAMPING) + noise * np.random.default_rng(seed).normal(size=TS.size)
    return sj.Measured(TS, {"position.mass.x": values}, noise=noise)


# The density ------------------------------------------------------------------------------------------------------


POSITIVE = [2.0, sj.Parameter(2.0, lower=1.0), sj.Parameter(2.0, lower=1.0, upper=7.0)]
ANY = [sj.Parameter(2.0, positive=False), sj.Parameter(2.0, upper=7.0, positive=False)]


@pytest.mark.parametrize("parameter", [*POSITIVE, *ANY, sj.Parameter(np.array([2.0, 3.0]), upper=4.0)])
def test_the_volume_is_the_derivative_of_the_map(parameter):
    unknowns, start = unknowns_from({"x": parameter})

    def flat(u):
        return jnp.ravel(unknowns.values_of(u)["x"])

    def volume(u):
        return np.sum(np.log(np.abs(np.diagonal(jax.jacfwd(flat)(jnp.asarray(u))))))

    u = unknowns.unknowns_of(start)
    there, elsewhere = u, u + 0.7
    change = float(log_volume(unknowns, jnp.asarray(elsewhere)) - log_volume(unknowns, jnp.asarray(there)))
    assert change == pytest.approx(volume(elsewhere) - volume(there), abs=1e-12)


def test_priors_are_densities():
    """Up to constants: quadrature of the density gives the moments that the prior names."""
    x = np.linspace(1e-4, 60.0, 400_001)

    def mean_of(prior, function=lambda x: x):
        density = np.exp(np.asarray(prior(jnp.asarray(x))))
        return np.sum(density * function(x)) / np.sum(density)

    assert mean_of(Normal(20.0, 2.0)) == pytest.approx(20.0, abs=1e-6)
    assert mean_of(Normal(20.0, 2.0), lambda x: (x - 20.0) ** 2) == pytest.approx(4.0, rel=1e-6)
    assert mean_of(LogNormal(2.0, 1.5), np.log) == pytest.approx(np.log(2.0), abs=1e-4)
    assert mean_of(LogNormal(2.0, 1.5), lambda x: np.log(x / 2.0) ** 2) == pytest.approx(np.log(1.5) ** 2, rel=1e-3)
    assert mean_of(Uniform()) == pytest.approx(30.0, rel=1e-3)
    assert float(LogUniform()(jnp.asarray(4.0)) - LogUniform()(jnp.asarray(2.0))) == pytest.approx(-np.log(2.0))


def test_a_positive_number_is_uniform_in_its_logarithm_by_default():
    unknowns, _ = unknowns_from(
        {"a": 1.0, "b": sj.Parameter(1.0, lower=0.5, upper=2.0), "c": -1.0, "d": sj.Parameter(1.0, upper=3.0)}
    )
    kinds = {name: type(prior) for name, prior in priors_for(unknowns, None).items()}
    assert kinds == {"a": LogUniform, "b": Uniform, "c": Uniform, "d": Uniform}


def test_the_whitened_posterior_is_round():
    jacobian = np.random.default_rng(0).normal(size=(50, 3)) * [1e3, 1.0, 1e-9]
    factor = whitening(jacobian)
    information = factor.T @ (jacobian.T @ jacobian + np.eye(3)) @ factor
    np.testing.assert_allclose(information, np.eye(3), atol=1e-9)
    assert np.max(np.abs(factor)) < 1.5


# Draws ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def fitted():
    """With noise so low that the posterior is the normal distribution of the fit."""
    return sj.fit(mount, {"stiffness": STIFFNESS, "damping": DAMPING}, measured(1e-4), progress=False)


@pytest.fixture(scope="module")
def sharp(fitted):
    return fitted, sj.posterior(fitted, n_samples=400, n_chains=3, n_warmup=75, rng=1, progress=False)


@pytest.mark.slow
def test_means_and_deviations_are_those_of_the_fit(sharp):
    fitted, found = sharp
    assert found.succeeded, found.warnings
    for name, deviation in fitted.standard_deviations.items():
        n = found.effective_samples[name]
        assert n > 400
        assert abs(found.mean[name] - fitted.estimates[name]) < 4 * deviation / np.sqrt(n) + 0.02 * deviation
        assert found.standard_deviations[name] == pytest.approx(deviation, rel=4 / np.sqrt(2 * n))
        assert found.errors_of_means[name] == pytest.approx(deviation / np.sqrt(n), rel=0.1)
    correlation = found.covariance[0, 1] / np.sqrt(found.covariance[0, 0] * found.covariance[1, 1])
    assert correlation == pytest.approx(fitted.correlation[0, 1], abs=4 / np.sqrt(n))


def test_the_density_and_its_gradient(sharp):
    """Against the closed form of the motion."""
    fitted, _ = sharp
    data = np.asarray(fitted.problem.experiments[0].measured.values["position.mass.x"])

    def reference(u):
        return -np.sum((motion(*np.exp(u)) - data) ** 2) / (2 * 1e-4**2)

    density = jax.jit(jax.value_and_grad(log_density_of(fitted.problem, priors_for(fitted.problem.unknowns, None))))
    value, slope = density(jnp.asarray(fitted.u))
    other, _ = density(jnp.asarray(fitted.u + 0.01))
    assert float(other - value) == pytest.approx(reference(fitted.u + 0.01) - reference(fitted.u), rel=3e-5)
    _, slope = density(jnp.asarray(fitted.u + 0.01))
    steps = 1e-5 * np.eye(2)
    differences = [(reference(fitted.u + 0.01 + h) - reference(fitted.u + 0.01 - h)) / 2e-5 for h in steps]
    np.testing.assert_allclose(slope, differences, rtol=1e-4)


def test_chains_move_and_differ(sharp):
    _, found = sharp
    assert found.us.shape == (3, 400, 2)
    assert len(np.unique(found.us[..., 0])) > 0.9 * found.us[..., 0].size


def test_what_a_reader_gets(sharp, tmp_path):
    import xarray

    _, found = sharp
    text = str(found)
    assert "stiffness" in text
    assert "R-hat" in text
    assert "3 chains of 400 draws" in text
    low, high = found.interval(0.95)["stiffness"]
    assert high - low == pytest.approx(3.92 * found.standard_deviations["stiffness"], rel=0.1)
    path = found.save(tmp_path / "posterior.nc")
    with xarray.open_dataset(path) as kept:
        np.testing.assert_array_equal(kept["stiffness"], found.samples["stiffness"])
        assert kept["stiffness"].dims == ("chain", "draw")
    figures = found.figures()
    assert [ax.get_xlabel() for ax in figures["pairs"].axes[2:]] == ["stiffness", "damping"]
    assert len(figures["traces"].axes) == 2


@pytest.mark.slow
def test_bounds_and_priors_against_quadrature():
    """Noise of a third of the motion: the damping fills its interval, and a prior holds the stiffness."""
    noise, highest, prior = 2e-3, 1.3e-3, Normal(2.2e4, 1e3)
    start = {"stiffness": STIFFNESS, "damping": sj.Parameter(DAMPING, lower=0.0, upper=highest)}
    problem = problem_of(mount, start, [measured(noise, seed=3)], noise)
    found = sj.posterior(
        problem, priors={"stiffness": prior}, n_samples=800, n_chains=3, n_warmup=100, rng=2, progress=False
    )
    assert found.n_divergences == 0
    k, b = np.meshgrid(np.linspace(1.4e4, 3e4, 321), np.linspace(0.0, highest, 402)[1:-1], indexing="ij")
    data = np.asarray(problem.experiments[0].measured.values["position.mass.x"])
    log = -np.sum((motion(k, b) - data) ** 2, -1) / (2 * noise**2) - ((k - 2.2e4) / 1e3) ** 2 / 2
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    assert np.max(weights[[0, -1]]) < 1e-4 * np.max(weights), "the grid holds the stiffness"
    assert weights[:, -1].sum() > 0.1 * weights.sum(0).max(), "the bound cuts the damping off"
    for name, values in (("stiffness", k), ("damping", b)):
        mean = np.sum(weights * values)
        deviation = np.sqrt(np.sum(weights * (values - mean) ** 2))
        n = found.effective_samples[name]
        assert abs(found.mean[name] - mean) < 4 * deviation / np.sqrt(n)
        assert found.standard_deviations[name] == pytest.approx(deviation, rel=4 / np.sqrt(2 * n) + 0.02)
    assert found.samples["damping"].max() < highest


# What cannot be drawn ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"n_samples": 0}, "n_samples = 0"),
        ({"n_chains": 0}, "n_chains = 0"),
        ({"target_acceptance": 1.5}, "target_acceptance"),
        ({"priors": {"mass": Uniform()}}, "'mass', which is not fitted"),
        ({"priors": {"damping": 3.0}}, "prior of 'damping' must be a function"),
        ({"priors": {"damping": lambda x: jnp.zeros(3)}}, "shape \\(3,\\)"),
    ],
)
def test_bad_requests(fitted, options, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.posterior(fitted, **options)


@pytest.mark.parametrize("make", [lambda: Normal(0.0, 0.0), lambda: LogNormal(1.0, 1.0), lambda: LogNormal(-1.0, 2.0)])
def test_bad_priors(make):
    with pytest.raises(sj.SceneError):
        make()


def test_the_extra_is_named_where_it_is_missing(fitted, monkeypatch):
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(sj.SceneError, match=r"pip install 'spherejax\[bayes\]'"):
        sj.posterior(fitted)


def test_noise_that_nobody_stated():
    start = {"stiffness": STIFFNESS, "damping": DAMPING}
    problem = problem_of(mount, start, [sj.Measured(TS, {"position.mass.x": motion(STIFFNESS, DAMPING)})])
    with pytest.raises(sj.SceneError, match="needs the noise"):
        sj.posterior(problem)


def test_arrays_keep_their_shape():
    from spherejax.studies.bayes.bayes_result import Posterior

    unknowns, start = unknowns_from({"matrix": np.arange(1.0, 7.0).reshape(2, 3), "number": 7.0})
    problem = SimpleNamespace(unknowns=unknowns, values_of=unknowns.values_of, names=unknowns.names)
    us = np.tile(unknowns.unknowns_of(start), (2, 5, 1))
    empty = np.zeros((2, 5))
    found = Posterior(problem, None, {}, us, empty, empty > 0, empty, 0, np.ones(2), False, (), 0.0)
    assert found.samples["matrix"].shape == (2, 5, 2, 3)
    np.testing.assert_allclose(found.samples["matrix"][1, 4], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert found.samples["number"].shape == (2, 5)
    np.testing.assert_allclose(found.mean["matrix"], [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    assert found.to_xarray()["matrix"].dims == ("chain", "draw", "matrix_0", "matrix_1")
