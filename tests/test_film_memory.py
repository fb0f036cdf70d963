"""A film that remembers, written by a user in one file: through steps, contacts, lanes, derivatives and files."""

import shutil

import jax
import jax.numpy as jnp
import my_laws
import numpy as np
import pytest

import spherejax as sj

TS = jnp.linspace(0.0, 0.02, 6)


def scene(film):
    """A ball that spins in its socket and is pushed to and fro across it; its energy goes into the film."""
    ball = sj.Body(
        0.2, (1e-5, 2e-5, 3e-5), velocity=(0.02, 0, 0.01), angular_velocity=(30, 0, 5), points={"center": (0, 0, 0)}
    )
    joint = sj.Spherical("ground.socket", "ball.center", sj.Lubricated(1e-4, 0.4, film=film), starts_concentric=False)
    push = sj.AppliedWrench("ball", force=lambda t: 5.0 * jnp.stack([jnp.sin(400.0 * t), jnp.cos(300.0 * t), 0.3]))
    return sj.Scene({"ball": ball}, {"joint": joint}, {"push": push}, ground_points={"socket": (0, 0, 0)})


def run_of(film, ts=TS, **options):
    return sj.simulate(scene(film), ts, throw=True, **options)


@pytest.fixture(scope="module")
def warm():
    return run_of(my_laws.WarmingFilm(1e-3), rtol=1e-9, track_work=True)


def test_a_memory_that_nothing_asks_changes_nothing(warm):
    plain = run_of(sj.laws.FullFilm(), rtol=1e-9)
    np.testing.assert_allclose(warm.position("ball"), plain.position("ball"), atol=1e-11)


def test_warmth_is_the_work_that_the_film_absorbed(warm):
    warmth = np.asarray(warm.memory("joint")["warmth"])
    assert warmth[0] == 0
    assert np.all(np.diff(warmth) > 0)
    np.testing.assert_allclose(1e-3 * warmth, warm.absorbed_work("joint"), rtol=1e-6)
    assert warm.memory("joint")["onset_rate"].max() == 0
    with pytest.raises(sj.SceneError, match="joint"):
        warm.memory("elbow")


def test_thinner_oil_yields_more(warm):
    thin = run_of(my_laws.WarmingFilm(1e-3, thinning=0.5))
    assert float(jnp.abs(thin.eccentricity("joint")[-1]).max()) > 1.01 * float(
        jnp.abs(warm.eccentricity("joint")[-1]).max()
    )


@pytest.mark.slow
def test_contacts_leave_it_alone():
    """A heavy ball squeezes the oil out and strikes: the onset's memory begins anew, the film's goes on."""
    body = sj.Body(2.0, (1e-3, 1e-3, 1e-3), velocity=(0.0, 0.0, -1.0), points={"ball": (0.0, 0.0, 0.0)})
    thin = sj.Lubricated(
        1e-4, 1e-4, film=my_laws.WarmingFilm(1e-6), friction=sj.LuGre(), conformity=sj.laws.SphericalProfile()
    )
    joint = sj.Spherical("ground.socket", "bob.ball", thin, starts_concentric=False)
    scene = sj.Scene({"bob": body}, {"joint": joint}, ground_points={"socket": (0.0, 0.0, 0.0)})
    run = sj.simulate(scene, jnp.linspace(0.0, 1e-3, 201), throw=True)
    remembered = {name: np.asarray(values) for name, values in run.memory("joint").items()}
    assert list(remembered) == ["onset_rate", "bristle_x", "bristle_y", "bristle_z", "warmth"]
    assert int(run.stats.n_onsets[0]) >= 1
    assert (remembered["onset_rate"] > 0).any()
    assert remembered["onset_rate"][0] == 0
    assert np.all(np.diff(remembered["warmth"]) >= 0)
    assert remembered["warmth"][-1] > remembered["warmth"][1] > 0


@pytest.mark.slow
def test_lanes_and_tables_carry_it():
    capacities = [1e-3, 2e-3]
    swept = sj.sweep(
        lambda c: scene(my_laws.WarmingFilm(c, thinning=0.5)),
        {"c": capacities},
        TS,
        record=["final position.ball"],
        progress=False,
    )
    for i, capacity in enumerate(capacities):
        alone = run_of(my_laws.WarmingFilm(capacity, thinning=0.5))
        np.testing.assert_allclose(swept["final_position.ball"][i], alone.position("ball")[-1], atol=1e-10)
    table = alone.to_xarray()["joint_memory"]
    np.testing.assert_array_equal(table.sel(memory="joint.warmth"), alone.memory("joint")["warmth"])


@pytest.mark.slow
def test_derivatives_by_its_numbers_agree_with_differences():
    def eccentricity(thinning):
        run = sj.simulate(scene(my_laws.WarmingFilm(1e-3, thinning=thinning)), TS[:2], rtol=1e-10)
        return 1e6 * run.eccentricity("joint")[-1, 0]

    value, slope = jax.jit(lambda x: jax.jvp(eccentricity, (x,), (1.0,)))(0.5)
    plain, h = jax.jit(eccentricity), 1e-3
    assert float(slope) == pytest.approx(float(plain(0.5 + h) - plain(0.5 - h)) / (2 * h), rel=1e-4)
    assert float(value) == pytest.approx(float(plain(0.5)), rel=1e-7)
    assert abs(float(slope)) > 1e-2


def test_a_film_of_ones_own_goes_through_a_file(tmp_path):
    shutil.copy(my_laws.__file__, tmp_path)
    scene = sj.gallery.four_bar(sj.Lubricated(1e-4, film=my_laws.WarmingFilm(0.05, 0.1, 0.2)))
    sj.save_scene(scene, tmp_path / "warm.toml")
    text = (tmp_path / "warm.toml").read_text()
    assert "J/K" in text
    again = sj.load_scene(tmp_path / "warm.toml", allow_code=True)
    film = again.joints["coupler_rocker"].model.film
    assert (float(film.capacity), float(film.cooling), float(film.thinning)) == (0.05, 0.1, 0.2)
