"""`spherejax identify`: candidates by their joints, the table and the verdict, files, and what makes no sense."""

import csv

import numpy as np
import pytest

import spherejax as sj
from spherejax.cli import main


@pytest.fixture
def record(tmp_path):
    """A pendulum in a soft bushing, and 40 instants of its place with an error of 10 um."""
    model = sj.Bushing(stiffness=2e3, damping=1.0)
    bob = sj.Body(1.0, (0.01, 0.01, 0.01), position=(0.2, 0.0, 0.0), points={"pin": (-0.2, 0.0, 0.0)})
    joint = sj.Spherical("ground.pin", "bob.pin", model)
    scene = sj.Scene({"bob": bob}, {"pin": joint}, ground_points={"pin": (0.0, 0.0, 0.0)})
    ts = np.linspace(0.01, 0.4, 40)
    places = np.asarray(sj.simulate(scene, np.concatenate([[0.0], ts])).position("bob"))[1:]
    noisy = places + 1e-5 * np.random.default_rng(0).normal(size=places.shape)
    lines = [f"{t!r},{x * 1e3!r},{z * 1e3!r}" for t, (x, _, z) in zip(ts.tolist(), noisy.tolist(), strict=True)]
    path = tmp_path / "bob.csv"
    path.write_text("\n".join(["time,position.bob.x [mm],position.bob.z [mm]", *lines]))
    return sj.save_scene(scene, tmp_path / "pinned.toml"), path


def identify(record, *words):
    scene, measured = record
    return main(["identify", str(scene), "--measured", str(measured), *map(str, words)])


@pytest.mark.slow
def test_a_soft_bushing_is_told_from_an_ideal_joint(record, tmp_path, capsys):
    bushing = "soft: bushing stiffness=1e3:1e2:1e5 damping=2:0.1:100"
    words = [
        "--of",
        "pin",
        "--noise",
        "10 um",
        "--candidate",
        "ideal",
        "--candidate",
        bushing,
        "--draws",
        8,
        "--starts",
        1,
    ]
    assert identify(record, *words, "--out", tmp_path / "out") == 0
    told, progress = capsys.readouterr()
    assert "soft" in told
    assert "best" in told
    assert "step" not in progress
    with (tmp_path / "out" / "models.csv").open() as file:
        models = [row[0] for row in csv.reader(file)][1:]
    assert models == ["soft", "ideal"]
    with (tmp_path / "out" / "estimates.csv").open() as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    assert float(rows["stiffness"]["low_95"]) < 2e3 < float(rows["stiffness"]["high_95"])
    assert float(rows["stiffness"]["estimate"]) == pytest.approx(2e3, rel=0.05)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "models.csv", "report.txt", "estimates.csv", "models.png",
    }  # fmt: skip
    assert identify(record, *words, "--out", tmp_path / "out") == 2
    assert "exists" in capsys.readouterr().err


REFUSED = {
    "one alone": (["--candidate", "ideal"], "--candidate must be given twice or more"),
    "twice": (["--candidate", "ideal", "--candidate", "ideal"], "--candidate ideal is given twice; give names"),
    "joint": (
        ["--candidate", "bushin k=1", "--candidate", "ideal"],
        "there is no joint 'bushin'; did you mean 'bushing'",
    ),
    "no joint": (["--candidate", "stiffness=1", "--candidate", "ideal"], "write [NAME:] JOINT [PARAMETER=VALUE ...]"),
    "quotes": (["--candidate", "bushing 'x", "--candidate", "ideal"], "No closing quotation"),
    "range": (
        ["--candidate", "bushing stiffness=1:2", "--candidate", "ideal"],
        "write NAME=VALUE or NAME=VALUE:LOW:HIGH",
    ),
    "unit": (["--candidate", "bushing stiffness='1 mm'", "--candidate", "ideal"], "'1 mm' is a length"),
    "--joint": (["--joint", "dry", "--candidate", "ideal", "--candidate", "bushing"], "leave it out"),
}


@pytest.mark.parametrize(("words", "message"), REFUSED.values(), ids=REFUSED)
def test_what_makes_no_sense_is_refused(record, capsys, words, message):
    assert identify(record, *words) == 2
    assert message in capsys.readouterr().err
