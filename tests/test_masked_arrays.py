"""Masked arrays of NumPy: the numbers behind a mask count nowhere; in measurements they are missing, as NaN is."""

import numpy as np
import pytest

import spherejax as sj

MASKED = np.ma.masked_array([0.0, 1.0, 9.0], mask=[False, False, True])
TS = np.linspace(0.0, 0.1, 3)


def falling(**more):
    return sj.Scene({"ball": sj.Body(**{"mass": 1.0, "inertia": (1.0, 1.0, 1.0), **more})}, {})


def simulated(scene):
    return sj.simulate(scene, TS)


@pytest.mark.parametrize(
    "use",
    [
        lambda: simulated(falling(position=MASKED)),
        lambda: simulated(falling(position=[MASKED[0], MASKED[1], MASKED[2]])),
        lambda: simulated(falling(inertia=MASKED + 1.0)),
        lambda: simulated(falling(mass=np.ma.masked)),
        lambda: simulated(sj.Scene(falling().bodies, {}, gravity=MASKED)),
        lambda: simulated(sj.Scene(falling().bodies, {}, {"push": sj.AppliedWrench("ball", MASKED)})),
        lambda: simulated(
            sj.Scene(
                falling().bodies, {},
                {"spring": sj.SpringDamper(("ground.o", "ball"), spring=sj.functions.Table([0.0, 1.0, 2.0], MASKED))},
                ground_points={"o": (0, 0, 1)},
            )
        ),
        lambda: sj.simulate(falling(), np.ma.masked_array(TS, mask=[0, 1, 0])),
        lambda: sj.studies.zipped({"mass": MASKED}),
        lambda: sj.studies.random_samples({"mass": MASKED[1:]}, 4),
        lambda: sj.Measured(np.ma.masked_array(TS, mask=[0, 1, 0]), {"position.ball.z": [1.0, 2.0, 3.0]}),
        lambda: sj.priors.LogNormal(np.ma.masked_array([1.0, 2.0], mask=[0, 1]), 2.0),
        lambda: sj.Body.box(MASKED + 1.0, mass=1.0),
    ],
)  # fmt: skip
def test_hidden_numbers_are_refused(use):
    with pytest.raises((sj.SceneError, ValueError), match=r"masked|finite|positive|three numbers|range"):
        use()


def test_a_mask_that_hides_nothing_is_no_mask():
    position = np.ma.masked_array([0.0, 0.0, 1.0], mask=False)
    np.testing.assert_array_equal(simulated(falling(position=position)).position("ball")[0], [0.0, 0.0, 1.0])


def test_masked_measurements_are_missing_ones():
    """As NaN is; the number behind the mask was fitted."""
    name = "position.ball.z"
    masked = sj.Measured(TS, {name: MASKED}, noise={name: np.ma.masked_array([1.0, 1.0, -5.0], mask=[0, 0, 1])})
    missing = sj.Measured(TS, {name: [0.0, 1.0, np.nan]})
    np.testing.assert_array_equal(masked.values[name], missing.values[name])
    assert masked.n_values == missing.n_values == 2
    build = lambda speed: falling(velocity=(0.0, 0.0, speed))  # noqa: E731
    fits = [sj.fit(build, {"speed": 1.0}, measured) for measured in (sj.Measured(TS, {name: MASKED}), missing)]
    assert fits[0].estimates["speed"] == fits[1].estimates["speed"]
    assert fits[0].estimates["speed"] == pytest.approx(1.0 / 0.05 + 9.81 * 0.025, rel=1e-6)
