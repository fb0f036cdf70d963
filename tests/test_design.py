"""Design: smooth peaks, limits and prices on problems with known answers, and the best shock mount of one mass."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import spherejax as sj
from spherejax.studies.design.constrained import Constrained, Interrupted, search
from spherejax.studies.design.problem import Measures, checked_limits

SPEED, MASS, ROOM = 1.0, 2.0, 0.02
"""A mass [kg] that comes with a speed [m/s], and the way that it may go [m]."""


# Smooth peaks --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sharpness", [4.0, 50.0, 500.0])
def test_a_smooth_peak_lies_between_the_largest_sample_and_its_bound(sharpness):
    values = jnp.array(np.random.default_rng(0).normal(size=200))
    largest = float(jnp.max(jnp.abs(values)))
    found = float(sj.studies.smooth_peak(values, sharpness))
    assert largest < found <= largest * 200 ** (1 / sharpness)
    assert float(sj.studies.smooth_peak(1e9 * values, sharpness)) == pytest.approx(1e9 * found, rel=1e-12)


def test_a_smooth_peak_of_equal_samples_reaches_its_bound():
    assert float(sj.studies.smooth_peak(jnp.full(8, -3.0), 3.0)) == pytest.approx(6.0, rel=1e-12)


def test_a_vector_counts_by_its_length():
    values = jnp.array([[3.0, 0.0, 4.0], [0.0, 1.0, 0.0]])
    assert float(sj.studies.smooth_peak(values, 1e3)) == pytest.approx(5.0, rel=1e-12)


@pytest.mark.parametrize("values", [np.zeros(5), np.zeros((5, 3))])
def test_a_history_of_zeros(values):
    peak, slope = jax.value_and_grad(sj.studies.smooth_peak)(jnp.asarray(values))
    assert float(peak) == 0.0
    np.testing.assert_array_equal(slope, 0.0)


def test_the_derivative_of_a_smooth_peak():
    values = jnp.array([0.0, 1.0, -2.0, 1.9])
    slope = jax.grad(sj.studies.smooth_peak)(values, 20.0)
    steps = 1e-6 * np.eye(4)
    differences = [
        (sj.studies.smooth_peak(values + h, 20.0) - sj.studies.smooth_peak(values - h, 20.0)) / 2e-6 for h in steps
    ]
    np.testing.assert_allclose(slope, differences, atol=1e-8)


# The search, on functions that cost nothing ------------------------------------------------------------------------


class Analytic:
    """Measures that are plain functions of u, in place of runs."""

    def __init__(self, functions, u0, bounds, breaks=None):
        self.functions, self.u0, self.bounds = functions, np.asarray(u0, float), np.asarray(bounds, float)
        self.measures = [SimpleNamespace(name=f"m{i}", unit="", kind="function") for i in range(len(functions))]
        self.unknowns = SimpleNamespace(names=["x", "y"], flat_values_of=lambda u: u)
        self.breaks, self.n_evaluations = breaks, 0

    def evaluate(self, u, sharpness):
        del sharpness
        self.n_evaluations += 1
        why = self.breaks(u, self.n_evaluations) if self.breaks else ""
        values = np.array([f(u) for f in self.functions])
        steps = 1e-6 * np.eye(len(u))
        slopes = np.array([[(f(u + h) - f(u - h)) / 2e-6 for h in steps] for f in self.functions])
        return Measures(np.array(u), values, values, slopes, why or "")


def searched(problem, limits, tolerance=1e-6):
    first = problem.evaluate(problem.u0, 1.0)
    task = Constrained(problem, first, limits, list(range(1, len(limits) + 1)), tolerance)
    return task, search(task, problem.u0, (1.0,), 100, None)


def distance(u):
    return (u[0] - 2) ** 2 + (u[1] - 1) ** 2 + 1


FREE = [(-np.inf, np.inf)] * 2


def test_without_limits_the_minimum_is_found():
    task, found = searched(Analytic([distance], [5.0, 5.0], FREE), [])
    np.testing.assert_allclose(found.end.u, [2.0, 1.0], atol=1e-4)
    assert found.converged
    assert task.best(found.seen).true[0] < 1 + 1e-8


def test_a_limit_is_kept_and_has_its_price():
    """Nearest point of x + y = 1 to (2, 1): (1, 0) at distance 3; d(3)/d(limit) = -2."""
    task, found = searched(Analytic([distance, lambda u: u[0] + u[1]], [0.0, 0.0], FREE), [(-np.inf, 1.0)])
    np.testing.assert_allclose(found.end.u, [1.0, 0.0], atol=1e-4)
    prices, left = task.multipliers(found.end)
    assert prices[0] * task.objective_scale == pytest.approx(2.0, rel=1e-3)
    assert left < 1e-3
    assert task.multipliers(found.start)[1] == pytest.approx(1.0)


def test_a_lower_limit():
    _, found = searched(Analytic([distance, lambda u: u[1]], [0.0, 4.0], FREE), [(3.0, np.inf)])
    np.testing.assert_allclose(found.end.u, [2.0, 3.0], atol=1e-4)


def test_the_optimum_may_lie_on_a_bound():
    task, found = searched(Analytic([distance], [0.5, 0.5], [(0.0, 1.0), (-np.inf, np.inf)]), [])
    np.testing.assert_allclose(found.end.u, [1.0, 1.0], atol=1e-4)
    assert all(one.u[0] <= 1.0 for one in found.seen)
    assert task.multipliers(found.end)[1] < 1e-3


def test_limits_that_nothing_keeps():
    limits = [lambda u: u[0] + u[1], lambda u: -u[0] - u[1]]
    task, found = searched(Analytic([distance, *limits], [0.0, 0.0], FREE), [(-np.inf, -1.0), (-np.inf, -1.0)])
    best = task.best(found.seen)
    assert not task.keeps_limits(best)
    assert np.max(task.excesses(best.true)) <= np.max(task.excesses(found.start.true)) + 1e-12


def test_designs_that_fail_are_turned_back_from():
    """Runs fail beyond x = 1.5, and the minimum without limits lies there."""
    fails = Analytic([distance], [-20.0, 1.0], FREE, breaks=lambda u, n: "it broke" if u[0] > 1.5 else "")
    task, found = searched(fails, [])
    assert any(not one.succeeded for one in found.seen)
    best = task.best(found.seen)
    assert best.succeeded
    assert distance(best.u) < distance(fails.u0) / 10


def test_an_interrupt_keeps_what_was_seen():
    def stop(u, n):
        if n > 4:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        searched(Analytic([distance], [5.0, 5.0], FREE, breaks=stop), [])
    assert len(stopped.value.search.seen) > 1
    assert stopped.value.search.message == "interrupted"


# A shock mount -------------------------------------------------------------------------------------------------


def mount(stiffness, damping):
    """A mass that arrives on an elastomer; damping [s] as in the elastomer's law k (e + b e_dot)."""
    body = sj.Body(MASS, (1e-2,) * 3, velocity=(SPEED, 0.0, 0.0), points={"ball": (0.0, 0.0, 0.0)})
    model = sj.Bushing(law=sj.laws.VectorElastomer(stiffness, damping))
    joint = sj.Spherical("ground.socket", "mass.ball", model, starts_concentric=False)
    points = {"socket": (0.0, 0.0, 0.0)}
    return sj.Scene({"mass": body}, {"mount": joint}, ground_points=points, gravity=(0.0, 0.0, 0.0))


TS = jnp.linspace(0.0, 0.08, 801)
FORCE, WAY = "peak reaction.mount", "peak eccentricity.mount"


def best_mount():
    """The best linear mount by its closed form: the least peak force times way over m v^2, over the damping ratio.

    x = v exp(-zeta w t) sin(d t) / d, d = w sqrt(1 - zeta^2); w = 1 and v = 1 leave one number to be found.
    """
    t = np.linspace(0.0, 4.0, 40001)

    def histories(zeta):
        d = np.sqrt(1 - zeta**2)
        decay = np.exp(-zeta * t)
        x = decay * np.sin(d * t) / d
        rate = decay * (np.cos(d * t) - zeta * np.sin(d * t) / d)
        return np.max(np.abs(x)), np.max(np.abs(x + 2 * zeta * rate))

    found = minimize_scalar(lambda zeta: np.prod(histories(zeta)), bounds=(0.01, 0.9), method="bounded")
    way, _ = histories(found.x)
    frequency = way * SPEED / ROOM
    return MASS * frequency**2, 2 * found.x / frequency, found.fun * MASS * SPEED**2 / ROOM


@pytest.fixture(scope="module")
def design():
    start = {"stiffness": sj.Parameter(2e4, lower=1e2, upper=1e6), "damping": 2e-4}
    return sj.optimize(mount, start, TS, minimize=FORCE, limits={WAY: ROOM}, progress=False)


def test_the_best_mount_of_a_mass_that_arrives(design):
    stiffness, damping, force = best_mount()
    assert design.succeeded, design.status
    assert design.objective == pytest.approx(force, rel=2e-3)
    assert design.values["stiffness"] == pytest.approx(stiffness, rel=0.05)
    assert design.values["damping"] == pytest.approx(damping, rel=0.1)
    assert design.objective < 0.6 * design.objective_at_start
    (way,) = design.limits
    assert way.active
    assert way.value <= ROOM * (1 + 1e-4)


def test_the_price_of_the_way(design):
    """The best force is c m v^2 / way: another meter is worth force / way."""
    assert design.limits[0].price == pytest.approx(design.objective / ROOM, rel=0.05)


def test_the_gradient_of_the_measures(design):
    """Against differences of tighter runs: those of the design's own tolerance, 1e-8, are off by 2e-5."""
    start = {"stiffness": sj.Parameter(2e4, lower=1e2, upper=1e6), "damping": 2e-4}
    tight = sj.optimize(
        mount, start, TS, minimize=FORCE, limits={WAY: ROOM}, rtol=1e-10, max_iterations=1, progress=False
    ).problem
    u, step = design.problem.u0, 1e-3
    slopes = design.problem.evaluate(u, 50.0).slopes
    for at, h in enumerate(step * np.eye(2)):
        more, less = (tight.evaluate(v, 50.0).smooth for v in (u + h, u - h))
        np.testing.assert_allclose(slopes[:, at], (more - less) / (2 * step), rtol=5e-6)


def test_the_report_and_the_figure(design):
    text = str(design)
    assert "converged" in text
    assert FORCE in text
    assert "at most 0.02" in text
    assert design.history[FORCE].shape == design.history["damping"].shape
    assert design.history["keeps limits"].any()
    (figure,) = design.figures().values()
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels == [f"{FORCE} [N]", f"{WAY} [m]"]


def test_the_run_of_the_design(design):
    # The objective comes with its gradient: a run of other steps, equal to the tolerance of the runs.
    assert float(jnp.max(jnp.linalg.norm(design.run.reaction("mount"), axis=1))) == pytest.approx(
        design.objective, rel=1e-7
    )


# What cannot be computed ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"minimize": "reaction.mount"}, "'reaction.mount' names no measure; write 'peak QUANTITY'"),
        ({"minimize": "peak reaction.mounting"}, "'peak reaction.mounting'.*'mount'"),
        ({"minimize": FORCE, "limits": {"peak way": 1.0}}, "'peak way'"),
        ({"minimize": FORCE, "limits": {WAY: "small"}}, "limits.*the largest value allowed"),
        ({"minimize": FORCE, "limits": {WAY: (2.0, 1.0)}}, "lower = 2 must be below upper = 1"),
        ({"minimize": FORCE, "starts": 0}, "starts = 0"),
        ({"minimize": FORCE, "rtol": -1.0}, "rtol"),
    ],
)
def test_bad_requests(options, said):
    with pytest.raises(sj.SceneError, match=said):
        sj.optimize(mount, {"stiffness": 1e4, "damping": 1e-3}, TS, **options)


def test_limits_as_pairs():
    assert checked_limits({"a": 2, "b": (1, 3)}) == {"a": (-np.inf, 2.0), "b": (1.0, 3.0)}
