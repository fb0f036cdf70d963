"""Motors, controllers and couplers along an angle: rad, N m and what follows from them, wherever a unit is told."""

import zipfile
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from controlling import ROTOR_FILE

import spherejax as sj
from spherejax.files.fields.number_units import unit_at

TURN = 'coordinate = { kind = "turn", bodies = ["ground", "rotor"], axis = [0, 0, 1] }\n'
ARC = 'coordinate = { kind = "turn", bodies = ["ground", "rotor"], axis = [0, 0, 1], radius = "20 mm" }\n'
TRAVEL = 'coordinate = { kind = "travel", ends = ["ground", "rotor"], direction = [0, 0, 1] }\n'


def loaded(tmp_path, *lines: str) -> sj.Scene:
    """The scene with a motor of these lines."""
    path = tmp_path / "motor.toml"
    path.write_text(ROTOR_FILE + "\n".join(lines))
    return sj.load_scene(path)


@pytest.mark.parametrize(
    ("lines", "wanted"),
    [
        (
            ('kind = "pid"', TURN, 'reference = "90 deg"', 'proportional = "0.5 N m/deg"',
             'derivative = "5 N mm s/rad"'),
            {"reference.value": np.pi / 2, "proportional": 90.0 / np.pi, "derivative": 5e-3},
        ),
        (
            ('kind = "pid"', TURN, "of_rate = true", 'reference = "300 rpm"', 'proportional = "0.5 N m s/rad"',
             'integral = "2 N m/rad"', 'limits = ["-3 N m", "3 N m"]'),
            {"reference.value": 10 * np.pi, "proportional": 0.5, "integral": 2.0, "limits": [-3.0, 3.0]},
        ),
        (
            ('kind = "sampled-pid"', TURN, 'period = "1 ms"', 'integral = "2 N m/(rad s)"', 'offset = "3 N cm"'),
            {"integral": 2.0, "offset": 0.03},
        ),
        (
            ('kind = "pid"', ARC, 'reference = "3 mm"', 'proportional = "5 N/mm"', 'limits = ["-1 N", "1 kN"]'),
            {"reference.value": 3e-3, "proportional": 5e3, "limits": [-1.0, 1e3]},
        ),
        (
            ('kind = "pid"', TRAVEL, "of_rate = true", 'reference = "3 mm/s"', 'proportional = "5 N s/mm"'),
            {"reference.value": 3e-3, "proportional": 5e3},
        ),
        (('kind = "actuator"', TURN, 'effort = "30 N cm"'), {"effort.value": 0.3}),
        (('kind = "sampled-actuator"', TURN, "times = [0, 1]", 'values = ["1 N m", "2 N m"]'), {"values": [1.0, 2.0]}),
        (
            ('kind = "coupler"', TURN.replace("coordinate", "first"), TURN.replace("coordinate", "second"),
             'ratio = -2.0', 'stiffness = "1 kN m/rad"', 'damping = "0.5 N m s/rad"', 'offset = "5 deg"'),
            {"stiffness": 1e3, "damping": 0.5, "offset": np.radians(5.0)},
        ),
        (
            ('kind = "coupler"', TURN.replace("coordinate", "first"), TRAVEL.replace("coordinate", "second"),
             'ratio = "2 mm/rad"', 'stiffness = "1 kN/m"', 'offset = "5 mm"'),
            {"ratio": 2e-3, "stiffness": 1e3, "offset": 5e-3},
        ),
    ],
)  # fmt: skip
def test_files_take_the_units_of_the_coordinate(lines, wanted, tmp_path):
    """And give them back: what is written in SI units has the unit in its comment."""
    scene = loaded(tmp_path, *lines)
    for name, value in wanted.items():
        found: Any = scene.forces["motor"]
        for step in name.split("."):
            found = getattr(found, step)
        np.testing.assert_allclose(found, value, rtol=1e-12, err_msg=name)
        assert unit_at(scene, ("forces", "motor", *name.split("."))), name
    again = tmp_path / "again.toml"
    sj.save_scene(scene, again)
    same = sj.load_scene(again)
    assert same.forces["motor"] == scene.forces["motor"] or repr(same.forces) == repr(scene.forces)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        (('kind = "pid"', TURN, 'reference = "0.1 m"'), r"reference: '0.1 m' is a length .* but an angle \[rad\]"),
        (('kind = "pid"', TURN, 'reference = "300 rpm"'), r"an angle \[rad\] is expected"),
        (('kind = "pid"', TURN, 'proportional = "3 N/m"'), r"a rotational stiffness \[N m/rad\] is expected"),
        (('kind = "pid"', TURN, 'derivative = "3 N s/m"'), r"a rotational damping \[N m s/rad\] is expected"),
        (('kind = "pid"', TURN, 'integral = "3 N/(m s)"'), r"\[N m/\(rad s\)\] is expected"),
        (('kind = "pid"', TURN, 'limits = ["-1 N", "1 N"]'), r"limits\[0\]: '-1 N' .* a moment \[N m\] is expected"),
        (('kind = "pid"', TURN, "of_rate = true", 'reference = "90 deg"'), r"an angular velocity \[rad/s\]"),
        (('kind = "pid"', TURN, 'reference = { kind = "linear", slope = "3 mm/s" }'), r"an angular velocity \[rad/s\]"),
        (('kind = "pid"', ARC, 'proportional = "3 N m/rad"'), r"a stiffness \[N/m\] is expected"),
        (('kind = "pid"', TRAVEL, 'reference = "90 deg"'), r"a length \[m\] is expected"),
        (('kind = "actuator"', TURN, 'effort = "30 N"'), r"a moment \[N m\] is expected"),
        (('kind = "actuator"', TURN, 'effort = { kind = "constant", value = "30 N" }'), r"a moment \[N m\]"),
        (
            ('kind = "coupler"', TURN.replace("coordinate", "first"), TURN.replace("coordinate", "second"),
             'stiffness = "1 N/m"'),
            r"a rotational stiffness \[N m/rad\] is expected",
        ),
    ],
)  # fmt: skip
def test_files_refuse_other_units_and_say_the_right_one(lines, words, tmp_path):
    with pytest.raises(sj.SceneError, match=words):
        loaded(tmp_path, *lines)


@pytest.fixture(scope="module")
def scene() -> sj.Scene:
    """A wheel by its speed, one that follows it, and a driven crank."""
    axis = (0.0, 0.0, 1.0)
    names = ("rotor", "wheel", "crank")
    bodies = {name: sj.Body(1.0, (0.01, 0.01, 0.02)) for name in names}
    bearings = {f"{name}_bearing": sj.Revolute(("ground", name), (0, 0, 0), axis) for name in names}
    driver = sj.RotationDriver(("ground", "crank"), axis, sj.functions.Linear(2.0))
    turns = [sj.Turn(("ground", name), axis) for name in ("rotor", "wheel")]
    forces = {
        "motor": sj.PID(turns[0], 3.0, 0.5, 1.0, of_rate=True),
        "belt": sj.forces.Coupler(turns[0], turns[1], stiffness=5.0, damping=0.1),
        "brake": sj.Actuator(turns[1], -0.01),
        "rim": sj.Actuator(sj.Turn(("ground", "wheel"), axis, radius=0.1), 0.1),
    }
    return sj.Scene(bodies, {**bearings, "driver": driver}, forces, gravity=(0, 0, 0))


UNITS = {
    "motor.effort": "N m",
    "motor.position": "rad",
    "motor.rate": "rad/s",
    "motor.reference": "rad/s",
    "motor.error": "rad/s",
    "motor.integral": "N m",
    "motor.turned": "rad",
    "motor.power": "W",
    "belt.lag": "rad",
    "belt.lag_rate": "rad/s",
    "belt.force": "N m",
    "brake.effort": "N m",
    "brake.rate": "rad/s",
    "rim.effort": "N",
    "rim.position": "m",
    "driving_effort_driver": "N m",
}


def test_tables_of_runs_have_them(scene):
    """The arc of `rim` on a radius of 0.1 m is 0.1 m for each rad of `brake`, and both name their units."""
    table = sj.simulate(scene, np.array([0.0, 0.1])).to_xarray()
    assert {name: table[name].attrs["units"] for name in UNITS} == UNITS
    np.testing.assert_allclose(table["rim.position"], 0.1 * table["brake.position"], rtol=1e-12)


@pytest.mark.slow
def test_fmus_have_them(scene, tmp_path):
    path = tmp_path / "motor.fmu"
    outputs = [name for name in UNITS if not name.endswith(("integral", "turned", "driver"))]
    gains = ["motor.proportional", "motor.integral", "belt.stiffness"]
    sj.export_fmu(scene, path, inputs=["motor.offset"], parameters=gains, outputs=outputs)
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    units = {each.get("name"): each.get("unit") for each in root.iter("Float64")}
    assert {name: units[name] for name in outputs} == {name: UNITS[name] for name in outputs}
    assert units["forces.motor.offset"] == "N m"
    assert [units[f"forces.{name}"] for name in gains] == ["N m s/rad", "N m/rad", "N m/rad"]
    told = {unit.get("name"): unit.find("BaseUnit") for unit in root.iter("Unit")}
    moment = told["N m"]
    assert moment is not None
    assert {key: moment.get(key) for key in ("kg", "m", "s")} == {"kg": "1", "m": "2", "s": "-2"}
