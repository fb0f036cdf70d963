"""Contacts in a fixed number of rows, within `jit`, `vmap` and `grad`: values, derivatives, and too few rows."""

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_between import BALL, GAP, HALF, STIFFNESS, ball, depth

import spherejax as sj
from spherejax.motion.results.impacts import COLUMNS

pytestmark = [
    pytest.mark.filterwarnings("ignore::spherejax.errors.OutOfRangeWarning"),  # 0.5 m/s press beyond Eq. 24's range
    pytest.mark.filterwarnings(
        "ignore::spherejax.errors.SerialRunsWarning"
    ),  # contacts of many runs are looked for one by one
]

ENDS = np.array([0.0, 1.2e-3])
"""Two impacts of a ball to and fro, at 0.5 m/s; at 0.25 m/s it is one."""


def rows_of(speed, **options):
    return sj.simulate(ball(speed), ENDS, rtol=1e-9).impact_rows("joint", rows=4, steps=512, **options)


def columns_of(rows):
    return [getattr(rows, name) for name in COLUMNS]


def pressed(push, mu):
    """A ball that is thrown and pushed to the wall, where it stays; at an angle, so that it rubs and creeps."""
    model = sj.Dry(clearance=1e-4, friction=sj.Threlfall(mu=mu, v1=1e-2))
    scene = cases.ball_in_socket(model, 0.2, (0.0, 0.25, 0.2))
    return sj.Scene(
        scene.bodies,
        scene.joints,
        {"push": sj.AppliedWrench("ball", force=(2.0, 0.0, push))},
        gravity=(0.0, 0.0, 0.0),
        ground_points=scene.ground_points,
    )


def test_rows_have_a_fixed_shape_in_a_trace():
    """Beside the slow tests of values: the whole way through a trace, without compiling it."""
    rows = jax.eval_shape(jax.vmap(rows_of), jnp.array([0.4, 0.5]))
    assert rows.is_contact.shape == rows.onset.shape == (2, 4)
    assert rows.impulse.shape == rows.place.shape == (2, 4, 3)
    assert rows.n_contacts.shape == (2,)


def test_what_cannot_be_is_answered_in_words():
    for options, words in (
        ({"rows": 0}, "rows = 0 must be a whole number"),
        ({"rows": 2.5}, "rows = 2.5 must be a whole number"),
        ({"contact_steps": True}, "contact_steps = True must be a whole number"),
    ):
        with pytest.raises(sj.SceneError, match=words):
            jax.eval_shape(
                lambda speed, options=options: sj.simulate(ball(speed), ENDS).impact_rows("joint", **options), 0.5
            )
    with pytest.raises(sj.SceneError, match="has no contact whose onsets are located"):
        jax.eval_shape(lambda speed: sj.simulate(ball(speed), ENDS).impact_rows("pin"), 0.5)
    with pytest.raises(sj.SceneError, match=r"jax\.vmap\(lambda run: run\.impact_rows\('joint'\)\)\(runs\)"):
        jax.eval_shape(lambda v: jax.vmap(lambda v: sj.simulate(ball(v), ENDS))(v).impact_rows("joint"), jnp.ones(2))


@pytest.mark.slow
def test_elastic_impacts_and_their_derivatives():
    """m v^2/2 = K d^2.5/2.5: force v^1.2, impulse 2 m v, duration 2.943 d/v; nothing is lost."""
    speeds = jnp.array([0.25, 0.5])
    both = jax.jit(jax.vmap(lambda v: (rows_of(v), jax.jacfwd(lambda v: columns_of(rows_of(v)))(v))))
    rows, slopes = both(speeds)
    slopes = dict(zip(COLUMNS, slopes, strict=True))
    np.testing.assert_array_equal(rows.is_contact, [[True, *3 * [False]], [True, True, False, False]])
    for i, n in enumerate((1, 2)):
        v = float(speeds[i])
        force, lasts = STIFFNESS * depth(v) ** 1.5, 2 * HALF * depth(v) / v
        onsets = GAP / v + np.arange(n) * (lasts + 2 * GAP / v)
        onset_slopes = -GAP / v**2 - np.arange(n) * (0.2 * lasts / v + 2 * GAP / v**2)
        sides = np.outer((-1.0) ** np.arange(n), [0.0, 0.0, 1.0])
        for name, values, by_speed, scale in (
            ("onset", onsets, onset_slopes, onsets[0]),
            ("release", onsets + lasts, onset_slopes - 0.2 * lasts / v, onsets[0]),
            ("approach_speed", np.full(n, v), np.ones(n), v),
            ("sliding_speed", np.zeros(n), np.zeros(n), v),
            ("peak_force", np.full(n, force), np.full(n, 1.2 * force / v), force),
            ("peak_penetration", np.full(n, depth(v)), np.full(n, 0.8 * depth(v) / v), depth(v)),
            ("impulse", -2 * BALL * v * sides, -2 * BALL * sides, BALL * v),
            ("energy_lost", np.zeros(n), np.zeros(n), BALL * v**2),
            ("place", sides, np.zeros((n, 3)), 1.0),
        ):
            column, slope = np.asarray(getattr(rows, name))[i], np.asarray(slopes[name])[i]
            np.testing.assert_allclose(column[:n], values, rtol=1e-7, atol=3e-7 * scale, err_msg=name)
            np.testing.assert_allclose(slope[:n], by_speed, rtol=2e-6, atol=2e-6 * scale / v, err_msg=name)
            assert not np.any(column[n:])
            assert not np.any(slope[n:])


@pytest.mark.slow
def test_rows_are_those_of_the_table_and_derivatives_those_of_differences():
    """With friction, and with a last contact that is open where the run ends."""
    first = sj.simulate(pressed(-30.0, 0.3), np.array([0.0, 8e-3]), rtol=1e-9).impacts("joint").isel(contact=-1)
    ts = np.array([0.0, 2e-3, float(first.onset + first.release) / 2])

    def rows(mu, push=-30.0, rtol=1e-9):
        return sj.simulate(pressed(push, mu), ts, rtol=rtol).impact_rows("joint", rows=64, contact_steps=4096)

    table = sj.simulate(pressed(-30.0, 0.3), ts, rtol=1e-9).impacts("joint")
    n = table.sizes["contact"]
    traced, slopes = jax.jit(lambda mu: (rows(mu), jax.jacfwd(lambda mu: columns_of(rows(mu)))(mu)))(0.3)
    assert int(traced.n_contacts) == n > 4
    assert np.isnan(table.release.values[-1])
    step = 1e-4
    ahead, behind = (rows(0.3 + sign * step, rtol=1e-12) for sign in (1, -1))
    for name, slope in zip(COLUMNS, slopes, strict=True):
        column = np.asarray(getattr(traced, name))[:n]
        scale = np.nanmax(np.abs(table[name].values))
        np.testing.assert_allclose(column, table[name].values, atol=1e-7 * scale, err_msg=name)
        # The release that is not there has the derivative 0.
        differences = np.nan_to_num(np.asarray(getattr(ahead, name)) - np.asarray(getattr(behind, name)))[:n] / (
            2 * step
        )
        # Friction changes little of what is lost: the derivative is right to some 1e-6 of the energy itself.
        atol = 5e-5 * np.abs(differences).max() + 2e-6 * scale / 0.3
        np.testing.assert_allclose(np.asarray(slope)[:n], differences, atol=atol, err_msg=name)


@pytest.mark.slow
def test_too_few_rows_are_loud():
    def total(speed, **options):
        options = {"rows": 1, "steps": 512, **options}
        rows = sj.simulate(ball(speed), ENDS, rtol=1e-9).impact_rows("joint", **options)
        return jnp.sum(jnp.where(rows.is_contact, rows.energy_lost, 0.0)), rows

    for options in ({}, {"rows": 4, "steps": 16}, {"rows": 4, "contact_steps": 8}):
        energy, rows = jax.jit(lambda speed, options=options: total(speed, **options))(0.5)
        assert np.isnan(energy)
        assert np.isnan(rows.peak_force).all()
    assert int(rows.n_contacts) == 2
    assert 512 > int(rows.n_steps) > int(rows.n_contact_steps) > 8
    # One lane does not spoil the others.
    energies, _ = jax.jit(jax.vmap(total))(jnp.array([0.25, 0.5]))
    np.testing.assert_array_equal(np.isnan(energies), [False, True])
