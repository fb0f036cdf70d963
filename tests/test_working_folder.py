"""No program and no code of the working folder is run: it may be somebody else's archive of scenes."""

import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from sweeping import pendulum

import spherejax as sj
from spherejax.output.search_path import program_on_path
from spherejax.studies.sweep.commit import UNKNOWN, commit_of

COMMIT = "0123456789abcdef0123456789abcdef01234567"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def program(path: Path, text: str) -> Path:
    """A shell script that can be run."""
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def repository(git: Path, head: str = "ref: refs/heads/main") -> Path:
    (git / "refs" / "heads").mkdir(parents=True)
    (git / "objects").mkdir()
    (git / "HEAD").write_text(head + "\n")
    return git


# Git ------------------------------------------------------------------------------------------------------------------


def test_a_sweep_runs_no_command_of_a_foreign_repository(folder):
    """`git describe --dirty` runs what `core.fsmonitor` names."""
    hook = program(folder / "hook", f"touch {folder / 'was-run'}")
    git = repository(folder / ".git", COMMIT)
    (git / "config").write_text(f"[core]\n\trepositoryformatversion = 0\n\tfsmonitor = {hook}\n")
    ts = np.linspace(0, 0.1, 3)
    sweep = sj.sweep(pendulum, {"gravity": [1.0, 9.81]}, ts, record=["final position.bob"], progress=False)
    assert not (folder / "was-run").exists()
    assert sweep.attrs["commit"] == COMMIT[:12]


def test_the_commit_is_what_git_says(folder):
    """In a repository, after its references were packed, on a detached HEAD, in a worktree, and in a folder within."""

    def git(*words, at=folder):
        names = [f"GIT_{who}_{what}" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")]
        environment = {**os.environ, **dict.fromkeys(names, "somebody"), "GIT_CONFIG_GLOBAL": os.devnull}
        return subprocess.run(["git", *words], cwd=at, env=environment, check=True, capture_output=True, text=True)

    if program_on_path("git") is None:
        pytest.skip("git is not installed")
    git("init", "-q", "-b", "topic/one")
    assert commit_of(folder) == UNKNOWN  # a branch without a commit
    git("commit", "-q", "--allow-empty", "-m", "first")
    expected = git("rev-parse", "HEAD").stdout[:12]
    (folder / "within" / "it").mkdir(parents=True)
    assert commit_of(folder) == commit_of(folder / "within" / "it") == expected
    git("pack-refs", "--all")
    assert not (folder / ".git" / "refs" / "heads" / "topic" / "one").exists()
    assert commit_of(folder) == expected
    git("commit", "-q", "--allow-empty", "-m", "second")
    git("worktree", "add", "-q", "-b", "other", "beside", "HEAD~1")
    assert commit_of(folder / "beside") == expected
    assert commit_of(folder) == git("rev-parse", "HEAD").stdout[:12] != expected
    git("checkout", "-q", "--detach", "HEAD~1")
    assert commit_of(folder) == expected


@pytest.mark.parametrize(
    "head", ["ref: ../../secret", "ref: refs/../../secret", "ref: /etc/passwd", "", "ref:", COMMIT[:20], "x" * 40]
)
def test_a_head_that_is_none_is_unknown(folder, head):
    repository(folder / ".git", head)
    (folder / "secret").write_text(COMMIT)
    assert commit_of(folder) == UNKNOWN


def test_what_is_no_repository_is_unknown(folder):
    assert commit_of(folder / "missing") == UNKNOWN
    (folder / ".git").write_text("gitdir: nowhere")
    assert commit_of(folder) == UNKNOWN
    (folder / ".git").write_bytes(b"\xff\xfe")
    assert commit_of(folder) == UNKNOWN
    (folder / ".git").unlink()
    (folder / ".git").symlink_to(".git")
    assert commit_of(folder) in (UNKNOWN, commit_of(folder.parent))
    (folder / ".git").unlink()
    (repository(folder / ".git") / "HEAD").unlink()
    os.mkfifo(folder / ".git" / "HEAD")  # would be waited for
    assert commit_of(folder) == UNKNOWN


# Programs and modules -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["", ".", "relative"])
def test_programs_are_not_taken_from_the_working_folder(folder, monkeypatch, path):
    (folder / "relative").mkdir()
    for place in (folder, folder / "relative"):
        program(place / "ffmpeg", "exit 0")
    beside = folder / "bin"
    monkeypatch.setenv("PATH", os.pathsep.join([path, str(beside)]))
    assert program_on_path("ffmpeg") is None
    beside.mkdir()
    program(beside / "ffmpeg", "exit 0")
    assert program_on_path("ffmpeg") == str(beside / "ffmpeg")
    assert program_on_path("./ffmpeg") is not None  # as the user has written it


@pytest.mark.parametrize("module", ["spherejax", "spherejax.cli"])
def test_the_command_imports_nothing_from_the_working_folder(folder, module):
    for name in ("numpy", "lazy_loader", "argparse", "difflib", "jax"):
        (folder / f"{name}.py").write_text("raise SystemExit('imported from the working folder')")
    done = subprocess.run([sys.executable, "-m", module, "list"], capture_output=True, text=True)
    assert "four-bar" in done.stdout, done.stderr
    assert done.returncode == 0


def test_figures_start_no_program_that_the_working_folder_asks_for(folder):
    """`text.usetex` runs LaTeX on what it is given."""
    (folder / "matplotlibrc").write_text("text.usetex: True\naxes.facecolor: black\n")
    code = "import spherejax.plot, matplotlib; print(*map(matplotlib.rcParams.get, ('text.usetex', 'axes.facecolor')))"
    code = "import spherejax.output.plot.style\n" + code
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["False", "black"], done.stderr


# Files ----------------------------------------------------------------------------------------------------------------


class _Touches:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize(
    "codecs",
    [
        {"filters": [{"id": "vlen-utf8"}, {"id": "pickle", "protocol": 5}]},
        {"filters": [{"id": "vlen-utf8"}], "compressor": {"id": "pickle", "protocol": 5}},
    ],
)
def test_stores_of_pickles_are_not_read(folder, monkeypatch, codecs):
    """Older versions of numcodecs run what is in them."""
    monkeypatch.setattr("numcodecs.pickles.ALLOW_UNSAFE_PICKLE_DECODE", True, raising=False)
    array = folder / "run.zarr" / "a"
    array.mkdir(parents=True)
    (folder / "run.zarr" / ".zgroup").write_text('{"zarr_format": 2}')
    (array / ".zattrs").write_text('{"_ARRAY_DIMENSIONS": ["x"]}')
    facts = {"zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "fill_value": None, "order": "C"}
    (array / ".zarray").write_text(json.dumps({**facts, "compressor": None, **codecs}))
    (array / "0").write_bytes(pickle.dumps([_Touches(folder / "was-run"), [1], "|O"]))
    with pytest.raises(sj.SceneError, match=r"'a/\.zarray' says that values are stored as pickles"):
        sj.load("run.zarr")
    assert not (folder / "was-run").exists()
