"""`spherejax draw` as a user meets it: files, exit codes, messages."""

import numpy as np
import pytest
from PIL import Image

import spherejax as sj
from spherejax import cli


def test_a_picture_of_the_start(tmp_path, capsys):
    path = tmp_path / "new" / "four_bar.png"
    assert cli.main(["draw", "four-bar", "--out", str(path)]) == 0
    assert capsys.readouterr().out == f"wrote {path}\n"
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        assert np.asarray(picture.convert("L")).std() > 5


def test_a_picture_at_a_time_shows_the_run(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(sj, "draw", lambda what, *a, **k: asked.append((what, a, k)) or _Blank())
    words = ["--joint", "dry", "--t", "0.01", "--trace", "rocker", "--view", "30", "-10", "--no-labels"]
    assert cli.main(["draw", "four-bar", *words, "--out", str(tmp_path / "x.svg")]) == 0
    _, (run, (t,), options) = asked  # the first call checks the names before the simulation
    assert isinstance(run, sj.Trajectory)
    assert (t, options["traces"], options["view"], options["labels"]) == (0.01, ["rocker"], (30.0, -10.0), False)
    assert float(run.ts[-1]) == 0.01
    assert options["title"] == "four-bar, dry joint: t = 0.01 s"


class _Blank:
    def savefig(self, path):
        path.write_text("picture")


def test_a_film_of_the_motion(tmp_path, capsys):
    path = tmp_path / "motion.gif"
    assert cli.main(["draw", "four-bar", "--t1", "0.02", "--fps", "10", "--slow", "40", "--out", str(path)]) == 0
    seen = capsys.readouterr()
    assert seen.out == f"wrote {path}\n"
    assert "[100 %] frame 9 of 9" in seen.err
    with Image.open(path) as film:
        assert (film.n_frames, film.info["duration"]) == (9, 100)
    assert cli.main(["draw", "four-bar", "--out", str(path)]) == 2
    assert "--overwrite" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--out", "x.jpg"], "the ending '.jpg' names no format; use .png, .svg, .pdf for a picture, .gif or .mp4"),
        (["--t", "0.1", "--out", "x.gif"], "--t means nothing for a film (.gif)"),
        (["--no-labels", "--out", "x.gif"], "--no-labels means nothing for a film"),
        (["--fps", "10", "--out", "x.png"], "--fps means nothing for a picture (.png)"),
        (["--slow", "-2", "--out", "x.gif"], "--slow = -2 must be positive"),
        (["--t", "-1", "--out", "x.png"], "--t = -1 must be a time after the start"),
        (["--t", "1", "--trace", "elbow", "--out", "x.png"], "there is no body or joint 'elbow' to trace"),
        (["--t", "1", "--magnify", "crank_pivot", "--out", "x.png"], "'crank_pivot' has no clearance"),
        (["--clearance", "1e-4", "--out", "x.png"], "--clearance means nothing with --joint ideal"),
    ],
)
def test_a_bad_request_is_one_line_and_costs_no_run(words, message, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sj, "simulate", lambda *a, **k: pytest.fail("simulated in vain"))
    assert cli.main(["draw", "four-bar", *words]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())
