"""`sj.compare_models`: told apart, not told apart, failing candidates; the arithmetic of the evidence."""

from typing import Any

import numpy as np
import pytest
from fitting import FREE_LENGTH, MASS, OFFSET, oscillation, oscillator

import spherejax as sj
from spherejax.studies.fit.correlation import ChannelResiduals
from spherejax.studies.fit.parameters import Parameter, unknowns_from
from spherejax.studies.model_choice.choice_result import comparison_of
from spherejax.studies.model_choice.evidence import (
    Innovations,
    SharedResiduals,
    criterion_of,
    held_out_score,
    n_determined,
    processes_of,
    standard_error,
    whitened,
)
from spherejax.studies.model_choice.fitted import Fitted
from spherejax.studies.model_choice.search import draws_over_ranges

TS = np.linspace(0.01, 2.0, 200)
NOISE = 1e-3  # [m]; 1 percent of the first deflection
STIFFNESS = sj.Parameter(150.0, lower=50.0, upper=800.0)
DAMPING = sj.Parameter(0.5, lower=1e-3, upper=50.0)


def damped(stiffness, damping):
    return oscillator(stiffness, damping)


def undamped(stiffness):
    return oscillator(stiffness, 0.0)


def known():
    return oscillator(210.0, 1.5)


def idle(stiffness, inertia):
    """Undamped, with a moment of inertia of a ball that does not turn."""
    ball = sj.Body(MASS, inertia * np.ones(3), position=(FREE_LENGTH + OFFSET, 0.0, 0.0), points={"center": (0, 0, 0)})
    spring = sj.SpringDamper(("ground.wall", "ball.center"), stiffness=stiffness, damping=0.0, free_length=FREE_LENGTH)
    return sj.Scene(
        {"ball": ball}, {}, forces={"spring": spring}, gravity=(0.0, 0.0, 0.0), ground_points={"wall": (0.0, 0.0, 0.0)}
    )


CANDIDATES = {
    "undamped": sj.studies.Candidate(undamped, {"stiffness": STIFFNESS}),
    "damped": (damped, {"stiffness": STIFFNESS, "damping": DAMPING}),
    "known": known,
}


def record(seed=0, errors=None, **motion):
    values = oscillation(TS, **motion)
    errors = np.random.default_rng(seed).normal(size=TS.size) if errors is None else errors
    return {"time": TS, "position.ball.x": values + NOISE * errors}


def compared(records, candidates=CANDIDATES, noise: float | None = NOISE, **options):
    options = {"draws": 16, "starts": 2, **options}
    return sj.compare_models(records, candidates, noise=noise, progress=False, **options)


def test_the_model_of_the_record_is_told_from_the_others():
    found = compared(record())
    assert found.best == "damped"
    assert found.is_decided
    assert not found.warnings
    assert "speak for damped" in found.verdict
    assert "known" in found.verdict
    rows = found.evidence
    assert list(rows) == ["damped", "known", "undamped"]
    assert rows["damped"].n_parameters == 2
    assert 1.99 < rows["damped"].n_determined <= 2.0
    assert rows["known"].n_parameters == 0
    assert rows["known"].n_determined == 0.0
    for name in ("known", "undamped"):
        assert rows[name].criterion > 10 * rows[name].criterion_error
        assert rows[name].is_told_apart
        assert rows[name].held_out > 10 * rows[name].held_out_error
        assert rows[name].prediction > 10 * rows["damped"].prediction
    assert abs(rows["damped"].residuals - 1) < 0.15
    assert abs(rows["damped"].prediction - 1) < 0.3
    assert abs(found.fits["damped"].estimates["damping"] - 1.5) < 0.1
    assert "known" not in found.fits
    text = str(found)
    assert "best" in text
    assert found.verdict in text
    table = found.to_xarray()
    assert table.attrs["best"] == "damped"
    assert float(table.criterion.sel(model="damped")) == 0.0
    assert found.plot().axes


def test_models_that_predict_alike_are_not_told_apart_and_the_simplest_is_named():
    models = {
        "idle": sj.studies.Candidate(
            idle, {"stiffness": STIFFNESS, "inertia": sj.Parameter(1e-3, lower=1e-4, upper=1e-2)}
        ),
        "undamped": CANDIDATES["undamped"],
        "known": known,
    }
    found = compared(record(1, damping=0.0), models)
    assert found.best == "undamped"
    assert not found.is_decided
    assert found.alike == ["idle"]
    assert "cannot tell undamped and idle apart" in found.verdict
    assert "not told apart" in str(found)
    row = found.evidence["idle"]
    assert not row.is_told_apart
    assert row.distance < 0.3
    # What leaves no trace in the record is a parameter that counts as none, and costs nothing.
    assert row.n_parameters == 2
    assert abs(row.n_determined - 1) < 1e-3
    assert abs(row.criterion) < 0.1
    assert found.evidence["known"].is_told_apart


def test_noise_that_is_not_stated_is_that_of_the_best_model():
    found = compared(record(), noise=None)
    assert found.best == "damped"
    assert found.is_decided
    assert abs(found.evidence["damped"].residuals - 1) < 0.1


def test_a_record_that_is_held_out_as_a_whole():
    later = dict(record(2))
    found = compared(record(), validate=later)
    assert found.best == "damped"
    assert found.is_decided
    assert found.is_validated
    assert abs(found.evidence["damped"].prediction - 1) < 0.2
    assert found.evidence["undamped"].prediction > 5


@pytest.mark.slow  # builders and records of their own are compiled
def test_records_with_what_each_has_for_itself():
    def with_speed(stiffness, damping, speed):
        return oscillator(stiffness, damping, speed)

    def without_damping(stiffness, speed):
        return oscillator(stiffness, 0.0, speed)

    def measured(seed, speed):
        own = {"speed": sj.Parameter(0.1, scale=1.0)}
        values = record(seed, speed=speed)["position.ball.x"]
        return sj.Measured(TS, {"position.ball.x": values}, name=f"at {speed}", own=own)

    models = {
        "damped": sj.studies.Candidate(with_speed, {"stiffness": 150.0, "damping": 0.5}),
        "undamped": sj.studies.Candidate(without_damping, {"stiffness": 150.0}),
    }
    found = compared([measured(3, 0.0), measured(4, 0.5)], models, validate=measured(5, -0.3))
    assert found.best == "damped"
    assert found.is_decided
    assert abs(found.fits["damped"].estimates["speed of at 0.5"] - 0.5) < 0.02
    assert abs(found.evidence["damped"].prediction - 1) < 0.2


def test_a_failing_candidate_is_a_row_with_its_reason():
    def impossible(stiffness):
        return oscillator(stiffness, -1.0)

    found = compared(record(), {**CANDIDATES, "bad": sj.studies.Candidate(impossible, {"stiffness": 150.0})})
    assert found.best == "damped"
    assert "damping" in found.evidence["bad"].diagnosis
    assert list(found.evidence)[-1] == "bad"
    assert "bad failed" in str(found)
    assert np.isnan(found.evidence["bad"].criterion)


def test_where_all_candidates_fail_nothing_is_said():
    found = comparison_of(
        {name: Fitted.failed("the run stopped") for name in ("a", "b")}, is_validated=False, seconds=0.0
    )
    assert found.best is None
    assert not found.is_decided
    assert "All candidates failed" in found.verdict
    assert "a failed: the run stopped" in str(found)
    with pytest.raises(sj.SceneError, match="nothing to draw"):
        found.plot()


@pytest.mark.parametrize(
    ("records", "candidates", "options", "message"),
    [
        (record(), {"damped": CANDIDATES["damped"]}, {}, "two or more models"),
        (record(), {**CANDIDATES, "odd": 3.0}, {}, "candidate 'odd' is 3.0"),
        (record(), {**CANDIDATES, "odd": damped}, {}, "'odd' has no start for 'stiffness', 'damping'"),
        (record(), CANDIDATES, {"held_out": 1.0}, "held_out = 1.0"),
        (record(), CANDIDATES, {"held_out": 0.9, "draws": 0}, "draws"),
        (sj.Measured(TS, {"position.ball.x": TS}, build=known), CANDIDATES, {}, "a builder of its own"),
        ({"time": TS, "position.bell.x": TS}, CANDIDATES, {}, "bell"),
        (
            sj.Measured(TS, {"position.ball.x": TS}, name="a"),
            {**CANDIDATES, "known": sj.studies.Candidate({"b": known})},
            {},
            "",
        ),
    ],
)
def test_bad_requests_are_refused_in_words(records, candidates, options, message):
    if not message:  # a builder for another record than there is: that candidate fails, the others do not
        found = compared(records, candidates, **options)
        assert "no builder for the record 'a'" in found.evidence["known"].diagnosis
        return
    with pytest.raises(sj.SceneError, match=message):
        compared(records, candidates, **options)


# The arithmetic -------------------------------------------------------------------------------------------------------


def innovations(n=60, k=3, seed=0):
    random = np.random.default_rng(seed)
    return Innovations(random.normal(size=n), random.normal(size=(n, k)), np.zeros(n, bool))


def test_the_criterion_counts_directions_that_the_data_determine():
    found = innovations()
    strong = found._replace(jacobian=1e4 * found.jacobian)
    assert np.isclose(criterion_of(strong), found.values @ found.values + 3 * np.log(60), rtol=1e-9)
    weak = found._replace(jacobian=found.jacobian * np.array([1e4, 1e4, 1e-6]))
    assert np.isclose(n_determined(weak.jacobian), 2.0, atol=1e-6)
    assert n_determined(np.zeros((60, 3))) == 0.0
    assert n_determined(np.zeros((60, 0))) == 0.0


def test_the_held_out_score_is_that_of_the_whole_normal_density():
    from scipy.stats import multivariate_normal

    found, seen = innovations(), innovations(seed=1).jacobian
    spread = np.linalg.inv(seen.T @ seen + np.eye(3))
    covariance: Any = np.eye(60) + found.jacobian @ spread @ found.jacobian.T
    exact = -2 * multivariate_normal.logpdf(found.values, np.zeros(60), covariance)
    assert np.isclose(held_out_score(found, seen), exact - 60 * np.log(2 * np.pi), rtol=1e-10)


def test_the_standard_error_is_that_of_many_records():
    random = np.random.default_rng(0)
    away = 0.3 * random.normal(size=80)
    noise = random.normal(size=(20_000, 80))
    differences = np.sum((noise + away) ** 2, 1) - np.sum(noise**2, 1)
    one = Innovations(noise[0], np.zeros((80, 0)), np.zeros(80, bool))
    error = standard_error(one._replace(values=noise[0] + away), one)
    assert np.isclose(np.std(differences), error, rtol=0.03)


def test_correlated_residuals_are_whitened_and_weigh_less():
    from scipy.signal import lfilter

    n = 4000
    errors = lfilter([0.6], [1.0, -0.8], np.random.default_rng(0).normal(size=n + 100))[100:]
    channel = ChannelResiduals("x", np.arange(n), (0, b""))
    residuals = SharedResiduals(np.asarray(errors), np.ones((n, 1)), [channel], np.zeros(n, bool))
    (process,) = processes_of(residuals, noise_is_known=True)
    assert abs(process.factors[0] - 0.8) < 0.05
    white = whitened(residuals, [process]).values
    assert abs(np.std(white) - 1) < 0.05
    assert abs(white[1:] @ white[:-1]) / n < 0.05
    # A constant shift: independent errors would take it for (1 + r) / (1 - r) = 9 times as much evidence.
    shifted = residuals._replace(errors=residuals.errors + 0.2)
    gained = standard_error(whitened(shifted, [process]), whitened(residuals, [process])) ** 2 / 4
    assert np.isclose(gained, n * 0.04 / 9, rtol=0.2)


def test_white_residuals_of_the_stated_size_keep_the_stated_noise():
    errors = np.random.default_rng(0).normal(size=400)
    channel = ChannelResiduals("x", np.arange(400), (0, b""))
    residuals = SharedResiduals(1.05 * errors, np.ones((400, 1)), [channel], np.zeros(400, bool))
    (stated,) = processes_of(residuals, noise_is_known=True)
    assert stated.factors.size == 0
    assert stated.variance == 1.0
    (large,) = processes_of(residuals._replace(errors=3.0 * errors), noise_is_known=True)
    assert abs(large.variance - 9) < 1


def test_draws_fill_the_ranges():
    start = {
        "decades": Parameter(1e-4, lower=1e-6, upper=1e-2),
        "share": Parameter(0.5, lower=0.2, upper=1.0),
        "open": Parameter(3.0),
        "row": Parameter(np.array([1.0, -2.0])),
    }
    unknowns, values = unknowns_from(start)
    u0 = unknowns.unknowns_of(values)
    us = draws_over_ranges(unknowns, u0, 40, np.random.default_rng(0))
    assert us.shape == (40, 5)
    assert np.array_equal(us[0], u0)
    drawn = [unknowns.values_of(u) for u in us[1:]]
    decades = np.log10([float(one["decades"]) for one in drawn])
    assert decades.min() >= -6
    assert decades.max() <= -2
    counts = np.histogram(decades, bins=4, range=(-6, -2))[0]
    assert counts.min() >= 9  # each decade has its fourth
    shares = np.array([float(one["share"]) for one in drawn])
    assert shares.min() >= 0.2
    assert shares.max() <= 1.0
    assert np.histogram(shares, bins=4, range=(0.2, 1.0))[0].min() >= 9
    opened = np.array([float(one["open"]) for one in drawn])
    assert opened.min() >= 0.3
    assert opened.max() <= 30.0


@pytest.mark.slow
@pytest.mark.parametrize("truth", ["ideal", "dry", "film", "bushing"])
def test_which_joint_of_a_four_bar(truth):
    def dry(clearance, restitution, mu):
        normal = sj.LankaraniNikravesh(restitution=restitution)
        return sj.gallery.four_bar(sj.Dry(clearance, normal=normal, friction=sj.Threlfall(mu=mu)))

    def film(clearance, viscosity):
        return sj.gallery.four_bar(sj.Lubricated(clearance, viscosity=viscosity))

    def bushing(stiffness, damping):
        return sj.gallery.four_bar(sj.Bushing(stiffness, damping))

    scenes = {
        "ideal": sj.gallery.four_bar(),
        "dry": dry(1.3e-4, 0.8, 0.06),
        "film": film(1.5e-4, 0.3),
        "bushing": bushing(8e4, 2e-3),
    }
    gap = sj.Parameter(1e-4, lower=3e-5, upper=6e-4)
    candidates = {
        "ideal": scenes["ideal"],
        "dry": (
            dry,
            {
                "clearance": gap,
                "restitution": sj.Parameter(0.8, lower=0.3, upper=1.0),
                "mu": sj.Parameter(0.05, lower=0.01, upper=0.3),
            },
        ),
        "film": (film, {"clearance": gap, "viscosity": sj.Parameter(0.2, lower=0.01, upper=5.0)}),
        "bushing": (
            bushing,
            {
                "stiffness": sj.Parameter(1e5, lower=5e3, upper=5e6),
                "damping": sj.Parameter(1e-3, lower=5e-5, upper=2e-2),
            },
        ),
    }
    ts = np.linspace(0.002, 1.0, 500)
    run = sj.simulate(scenes[truth], np.append(0.0, ts), rtol=1e-9)
    clean = np.asarray(run.position("rocker"))[1:, 2]
    noise = 0.01 * float(np.std(clean))
    values = clean + noise * np.random.default_rng(0).normal(size=ts.size)
    found = sj.compare_models(
        {"time": ts, "position.rocker.z": values}, candidates, noise=noise, draws=48, starts=3, rtol=1e-6,
        max_steps=20_000, progress=False,
    )  # fmt: skip
    assert found.best == truth
    assert set(found.alike) <= ({"bushing"} if truth == "ideal" else set())
