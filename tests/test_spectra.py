"""Spectra from the steps of runs: tones of known amplitude and phase, and impacts that samples would fold."""

import math

import cases
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from scipy.integrate import quad

import spherejax as sj
from spherejax.motion.results.spectra import fourier, windowed
from spherejax.motion.results.steps import SHARES, Steps

STIFFNESS, MASS = 1e4, 0.2
TONE = math.sqrt(STIFFNESS / MASS) / (2 * math.pi)


def steps_to(end, n, seed=0):
    """Steps of unequal length from 0.3 s on; the states do not matter."""
    cuts = np.sort(np.random.default_rng(seed).uniform(size=n - 1))
    ends = 0.3 + np.append(cuts, 1.0) * (end - 0.3)
    begins = np.concatenate([[0.3], ends[:-1]])
    inside = begins[:, None] + (ends - begins)[:, None] * np.asarray(SHARES)
    return Steps(0.3, np.zeros(1), ends, np.zeros((n, 1)), inside, np.zeros((n, len(SHARES), 1)))


def test_cubics_are_integrated_exactly_at_any_frequency():
    steps = steps_to(1.7, 3)
    polynomial = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0])
    frequencies = np.array([0.0, 0.4, 7.0, -7.0, 300.0])
    found = fourier(steps, polynomial(steps.inside)[..., None], frequencies)[:, 0]
    for frequency, value in zip(frequencies, found, strict=True):
        omega = 2 * math.pi * frequency
        options = {"limit": 2000, "epsabs": 1e-12, "epsrel": 1e-12}
        parts = [
            quad(lambda t, f=f, omega=omega: polynomial(t) * f(omega * t), 0.3, 1.7, **options)[0]
            for f in (math.cos, math.sin)
        ]
        assert value == pytest.approx(parts[0] - 1j * parts[1], abs=1e-10)


def test_a_tone_shows_its_amplitude_and_its_phase():
    steps = steps_to(2.3, 400)
    duration = 2.0

    def signal(t):
        return 3.0 * np.cos(2 * np.pi * 10.0 * t + 0.7)

    frequencies = 10.0 + np.array([0.0, 1.0, -1.0, 2.0, 5.0]) / duration
    lines = windowed(steps, signal(steps.inside)[..., None], frequencies, duration)[:, 0]
    np.testing.assert_allclose(np.abs(lines), [3.0, 1.5, 1.5, 0.0, 0.0], atol=2e-3)
    assert np.angle(lines[0]) == pytest.approx(0.7, abs=1e-3)


@pytest.fixture(scope="module")
def swinging():
    """A mass on a bushing, pulled out by 0.1 mm along z: 35.6 Hz, for a whole number of periods."""
    scene = cases.ball_in_socket(
        sj.Bushing(law=sj.laws.VectorElastomer(STIFFNESS, 0.0)), mass=MASS, velocity=(0, 0, 0.02)
    )
    return sj.simulate(scene, jnp.array([0.0, 20 / TONE]), rtol=1e-10, throw=True)


def test_an_oscillator_has_one_line(swinging):
    found = swinging.spectrum("position.ball")
    amplitude = 0.02 / (2 * math.pi * TONE)
    assert found.attrs["quantity"] == "position.ball"
    assert found.amplitude.attrs["units"] == "m"
    lines = found.amplitude.sel(axis="z")
    assert float(lines.frequency[int(lines.argmax("frequency"))]) == pytest.approx(TONE)
    assert float(lines.max()) == pytest.approx(amplitude, rel=1e-5)
    assert float(found.amplitude.sel(axis="x").max()) < 1e-12
    # z = A sin(omega t) is a cosine that lags by a quarter.
    assert float(found.phase.sel(axis="z")[int(lines.argmax("frequency"))]) == pytest.approx(-math.pi / 2, abs=1e-4)
    component = swinging.spectrum("reaction.joint.z", [TONE])
    assert component.amplitude.dims == ("frequency",)
    assert float(component.amplitude[0]) == pytest.approx(STIFFNESS * amplitude, rel=1e-5)
    assert component.amplitude.attrs["units"] == "N"


def test_impacts_are_not_folded():
    """Against the Fourier integral of fine samples; coarse ones would tell tones of the wrong size."""
    scene = cases.ball_in_socket(sj.Dry(1e-4, normal=sj.Hertz()), velocity=(0.0, 0.0, 0.05))
    run = sj.simulate(scene, jnp.linspace(0.0, 0.02, 11), rtol=1e-10, throw=True)
    fine = sj.simulate(scene, jnp.linspace(0.0, 0.02, 100_001), rtol=1e-10, throw=True)
    force, ts = np.asarray(fine.reaction("joint"))[:, 2], np.asarray(fine.ts)
    window = 0.5 * (1 - np.cos(2 * np.pi * ts / 0.02))
    frequencies = np.array([50.0, 250.0, 1000.0, 5000.0, 20000.0])
    wave = np.exp(-2j * np.pi * frequencies[:, None] * ts)
    wanted = 2 / 0.01 * np.trapezoid(window * (force - np.trapezoid(force, ts) / 0.02) * wave, ts)
    found = run.spectrum("reaction.joint.z", frequencies).amplitude
    np.testing.assert_allclose(found, np.abs(wanted), atol=2e-4 * np.abs(wanted).max())
    coarse = np.asarray(run.reaction("joint"))[:, 2]
    assert abs(np.abs(np.fft.rfft(coarse)).max() / 5 - np.abs(wanted).max()) > 0.3 * np.abs(wanted).max()


def test_what_has_no_spectrum_says_so(swinging):
    with pytest.raises(sj.SceneError, match=r"position\.bal"):
        swinging.spectrum("position.bal")
    with pytest.raises(sj.SceneError, match="frequencies"):
        swinging.spectrum("position.ball", [-1.0])

    def run(velocity):
        return sj.simulate(cases.ball_in_socket(sj.Bushing(1e4, 0.0), velocity=velocity), jnp.array([0.0, 1e-3]))

    runs = jax.vmap(run)(jnp.eye(3) * 0.01)
    with pytest.raises(sj.SceneError, match="single run"):
        runs.spectrum("position.ball")


def test_a_figure_of_a_spectrum_reaches_as_far_as_there_is_content():
    """A tone of 10 Hz among frequencies up to 1000 Hz; noise of a thousandth is no content."""
    frequencies = np.arange(1.0, 1001.0)
    amplitude = np.where(frequencies == 10.0, 1.0, 1e-3)
    attributes = {"quantity": "position.bob.z", "duration": 1.0}

    def shown(values):
        found = xarray.Dataset(
            {"amplitude": ("frequency", values, {"units": "m"})},
            {"frequency": frequencies, "axis": "z"},
            attrs=attributes,
        )
        (ax,) = sj.plot.spectrum(found).axes
        return ax.get_xlim()[1], [text.get_text() for text in ax.texts], ax.get_yscale()

    assert shown(amplitude) == (11.0, ["below 0.5% of the largest from 11 to 1000 Hz"], "linear")
    low_tone = np.where(frequencies == 500.0, 0.01, amplitude)
    assert shown(low_tone)[0] == pytest.approx(550.0)
    assert shown(low_tone)[2] == "log"
    assert shown(np.full(1000, 1.0)) == (1000.0, [], "linear")
