"""Roads: the spectral density of ISO 8608 by Welch's estimate, and measured profiles from files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import welch

import spherejax as sj


def test_random_road_has_the_density_of_its_class():
    """Variance of bands, by Welch's method, over eight roads of two kilometers."""
    spacing, x = 0.1, np.arange(0.0, 2000.0, 0.1)
    densities = []
    for seed in range(8):
        road = sj.functions.RandomRoad.of_class("C", seed)
        z = np.asarray(jax.vmap(road)(jnp.asarray(x)))
        assert z[0] == 0.0
        frequencies, density = welch(z, 1 / spacing, nperseg=4096)
        densities.append(density)
    density = np.mean(densities, 0)
    for low, high in ((0.1, 0.4), (0.4, 1.6)):
        band = (frequencies >= low) & (frequencies < high)
        expected = 256e-6 * 0.1**2 * (1 / low - 1 / high)
        assert np.trapezoid(density[band], frequencies[band]) == pytest.approx(expected, rel=0.12)


def test_seeds_differ_and_repeat_and_height_follows_the_root_of_roughness():
    one, same, other = (sj.functions.RandomRoad(64e-6, seed)(12.3) for seed in (1, 1, 2))
    assert one == same != other
    slope = jax.grad(lambda g: sj.functions.RandomRoad(g, 1)(12.3))(64e-6)
    assert float(slope) == pytest.approx(float(one) / (2 * 64e-6), rel=1e-12)


def test_bad_roads_are_named():
    with pytest.raises(sj.SceneError, match="no road class 'I'"):
        sj.functions.RandomRoad.of_class("I")
    with pytest.raises(sj.SceneError, match="waviness = 1 must lie between"):
        sj.simulate(sj.gallery.double_wishbone(road=sj.functions.RandomRoad(1e-6, waviness=1.0)), [0.0, 0.1])


def test_measured_profiles_have_units_and_lines(tmp_path):
    file = tmp_path / "road.csv"
    file.write_text("x [m], z [mm]\n0, 0\n0.5, 2\n1.0, 4\n2.0, 8\n")
    assert float(sj.vehicle.load_road(file)(0.75)) == pytest.approx(3e-3)
    averaged = sj.vehicle.load_road(file, spacing=1.0)
    np.testing.assert_allclose(averaged.x, [0.5, 1.5])
    np.testing.assert_allclose(averaged.y, [2e-3, 6e-3])
    file.write_text("x [m], z [mm]\n0, 0\n0, 2\n")
    with pytest.raises(sj.SceneError, match=r"road\.csv:3: x = 0 m does not lie behind"):
        sj.vehicle.load_road(file)
    file.write_text("x [m], y [mm]\n0, 0\n1, 2\n")
    with pytest.raises(sj.SceneError, match=r"column .*y \[mm\].* is none of a road"):
        sj.vehicle.load_road(file)
