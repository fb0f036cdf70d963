"""A double pendulum with a dry elbow, as a scene file and in Python, for the tests of scene files."""

from pathlib import Path

import numpy as np

import spherejax as sj

TEXT = """\
title = "double pendulum with a dry elbow"

[ground_points]
hook = [0, 0, 0]

[bodies.upper]
mass = "1.2 kg"
inertia = ["120 kg cm^2", "120 kg cm^2", "4 kg cm^2"]
position = [0.15, 0, 0]
rotation = { axis = [0, 1, 0], angle = "90 deg" }
points = { top = [0, 0, "-15 cm"], bottom = [0, 0, "15 cm"] }

[bodies.lower]
mass = 0.8
inertia = [0.006, 0.006, 0.0003]
position = ["40 cm", 0, 0]
rotation = { axis = [0, 1, 0], angle = "90 deg" }
points = { top = { values = [0, 0, -10], unit = "cm" } }

[joints.shoulder]
kind = "spherical"
socket = "ground.hook"
ball = "upper.top"

[joints.elbow]
kind = "spherical"
socket = "upper.bottom"
ball = "lower.top"
studied = true

[joints.elbow.model]
kind = "dry"
clearance = "0.1 mm"
normal = { kind = "lankarani-nikravesh", restitution = 0.9 }
friction = { kind = "threlfall", mu = 0.1 }

[simulation]
t1 = "40 ms"
samples = 5
rtol = 1e-6
solver = "dopri8"
"""


def scene() -> sj.Scene:
    """The scene of `TEXT`, in Python."""
    quaternion = np.array([np.cos(np.deg2rad(90.0) / 2), 0.0, np.sin(np.deg2rad(90.0) / 2), 0.0])
    upper = sj.Body(
        1.2, (0.012, 0.012, 4e-4), (0.15, 0.0, 0.0), quaternion,
        points={"top": (0.0, 0.0, -0.15), "bottom": (0.0, 0.0, 0.15)},
    )  # fmt: skip
    lower = sj.Body(0.8, (0.006, 0.006, 0.0003), (0.4, 0.0, 0.0), quaternion, points={"top": (0.0, 0.0, -0.1)})
    model = sj.Dry(clearance=1e-4, normal=sj.LankaraniNikravesh(restitution=0.9), friction=sj.Threlfall(mu=0.1))
    joints = {
        "shoulder": sj.Spherical("ground.hook", "upper.top"),
        "elbow": sj.Spherical("upper.bottom", "lower.top", model),
    }
    return sj.Scene({"upper": upper, "lower": lower}, joints, ground_points={"hook": (0.0, 0.0, 0.0)})


def write(folder: Path, text: str = TEXT, *changes: tuple[str, str]) -> Path:
    """The text in a file, each change made once."""
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "scene.toml"
    path.write_text(text)
    return path
