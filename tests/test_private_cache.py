"""What is kept on disk is code that is executed: it is the user's own, and is what its name says."""

import os
import shutil
import stat
import subprocess
import sys
import warnings

import pytest

from spherejax import runtime
from spherejax.program_cache import disk_cache, folders

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners here")
NOBODY = 65534

FALL = """
import sys
import numpy as np
import spherejax as sj
gravity = float(sys.argv[1])
scene = sj.Scene({"ball": sj.Body(1.0, (1e-3, 1e-3, 1e-3))}, {}, gravity=(0.0, 0.0, gravity))
run = sj.simulate(scene, np.linspace(0.0, 1.0, 3))
print(run.status, round(float(run.position("ball")[-1, 2]), 9))
"""


def fall(cache, gravity):
    """Status and height [m] of a ball that falls for a second, in a process of its own, and what it warns of."""
    environment = {**os.environ, "SPHEREJAX_CACHE": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    code = [sys.executable, "-c", FALL, str(gravity)]
    done = subprocess.run(code, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip(), done.stderr


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A folder that may be chosen; the process has its own again afterwards."""
    import jax

    monkeypatch.setattr(folders, "_in_use", list(folders._in_use))
    before = {name: jax.config.values[name] for name in ("jax_compilation_cache_dir",)}
    yield tmp_path / "cache"
    for name, value in before.items():
        jax.config.update(name, value)


def configured(folder):
    """Whether the process keeps programs in a folder, and what it says where it does not."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        runtime.configure(cache=folder)
    words = [str(each.message) for each in said if each.category is runtime.ConfigurationWarning]
    assert (folders.current() is None) == bool(words)
    return "".join(words)


def compiled(cache):
    return cache / f"compiled-{folders.kind_of_processor()}"


def at(cache, place):
    """One of the folders of a cache that is the folder `in` of another one."""
    return {"": cache / "in", "compiled": compiled(cache / "in"), "kept": cache / "in" / "kept", "above": cache}[place]


def foreign(path):
    """Give a file or a folder to somebody else."""
    if os.getuid() != 0:
        pytest.skip("only root can give files away")
    os.chown(path, NOBODY, NOBODY)


# Where ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("word", "is_on"), [("0", False), ("off", False), ("False", False), ("1", True), ("on", True)])
def test_a_switch_is_no_folder(word, is_on, tmp_path):
    code = "import spherejax, jax; print(jax.config.values['jax_compilation_cache_dir'])"
    environment = {**os.environ, "SPHEREJAX_CACHE": word, "XDG_CACHE_HOME": str(tmp_path / "users"), "PYTHONPATH": ""}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True
    )
    folder = done.stdout.strip()
    assert folder.startswith(str(tmp_path / "users")) if is_on else folder == "None"
    assert not (tmp_path / word).exists()


@pytest.mark.parametrize("umask", [0o022, 0o002, 0o000])
def test_a_folder_that_is_made_is_private_whatever_the_umask(cache, umask):
    before = os.umask(umask)
    try:
        assert configured(cache / "deep") == ""
        disk_cache.save("key", 1)
    finally:
        os.umask(before)
    for folder in (cache, cache / "deep", compiled(cache / "deep"), cache / "deep" / "kept"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert configured(cache / "deep") == ""
    assert disk_cache.load("key") == 1


@pytest.mark.parametrize("place", ["", "compiled", "kept", "above"])
def test_a_folder_that_others_may_write_is_done_without(cache, place):
    assert configured(cache / "in") == ""
    disk_cache.save("key", 1)
    cache.chmod(0o755)
    assert configured(cache / "in") == ""
    disk_cache.save("key", 1)
    folder = at(cache, place)
    folder.chmod(0o777)
    words = configured(cache / "in")
    assert f"others may write to {str(folder)!r}" in words
    assert "Delete the folder" in words
    assert "\n" not in words
    assert disk_cache.load("key") is None
    folder.chmod(0o700)
    assert configured(cache / "in") == ""


def test_a_sticky_folder_above_will_do(cache):
    cache.mkdir()
    cache.chmod(0o1777)
    assert configured(cache / "mine") == ""


@pytest.mark.parametrize("place", ["", "compiled", "kept", "above"])
def test_a_folder_of_somebody_else_is_done_without(cache, place):
    assert configured(cache / "in") == ""
    disk_cache.save("key", 1)
    folder = at(cache, place)
    foreign(folder)
    assert f"{str(folder)!r} belongs to " in configured(cache / "in")


def test_a_folder_of_a_group_of_several_is_done_without_and_one_of_the_user_alone_is_not(cache, monkeypatch):
    """With a umask of 002 all that a user makes may be written by the group: often one of that user alone."""
    import grp
    import pwd

    assert configured(cache) == ""
    compiled(cache).chmod(0o775)

    gid = cache.stat().st_gid

    def group(name, members):
        folders._is_private.cache_clear()
        user = pwd.struct_passwd(("me", "x", os.getuid(), gid, "", "", ""))
        monkeypatch.setattr(pwd, "getpwuid", lambda _: user)
        monkeypatch.setattr(grp, "getgrgid", lambda _: grp.struct_group((name, "x", gid, members)))
        return configured(cache)

    os.chown(compiled(cache), -1, gid)
    try:
        assert group("me", []) == group("me", ["me"]) == ""
        assert "others may write" in group("me", ["me", "you"])
        if gid != 0:  # that of root is trusted, whatever it is called
            assert "others may write" in group("users", [])
    finally:
        monkeypatch.undo()
        folders._is_private.cache_clear()


def test_a_container_that_does_not_know_its_user_trusts_no_group(monkeypatch):
    import pwd

    def unknown(_):
        raise KeyError

    monkeypatch.setattr(pwd, "getpwuid", unknown)
    try:
        assert not folders._is_private.__wrapped__(os.getgid())
    finally:
        monkeypatch.undo()


def test_links_are_followed_before_anybody_is_trusted(cache):
    real = cache.with_name("real")
    assert configured(real) == ""
    cache.symlink_to(real)
    assert configured(cache) == ""
    assert folders.current() == real
    real.chmod(0o777)
    assert "others may write" in configured(cache)


# What -----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("whose", ["others may write", "somebody else's"])
def test_an_entry_of_jax_that_somebody_else_could_have_written_is_not_executed(cache, whose):
    """JAX itself looks at no owner."""
    assert configured(cache) == ""
    compiled(cache).chmod(0o755)
    entry = compiled(cache) / "jit_f-0123-cache"
    entry.write_bytes(b"code")
    entry.chmod(0o644)
    assert configured(cache) == ""
    if whose == "others may write":
        entry.chmod(0o666)
        assert "others may write to" in configured(cache)
        compiled(cache).chmod(0o700)  # nobody can enter, so nobody can write
        assert configured(cache) == ""
    else:
        foreign(entry)
        assert "belongs to" in configured(cache)


def test_files_that_others_may_write_are_not_opened(cache):
    assert configured(cache) == ""
    disk_cache.save("key", "kept")
    for mode in (0o606, 0o660):
        (cache / "kept" / "key").chmod(mode)
        assert disk_cache.load("key") is None
    disk_cache.save("key", "anew")
    assert disk_cache.load("key") == "anew"


def test_a_file_that_was_copied_over_another_is_not_loaded(cache):
    """It has its content whole, under the name of something else."""
    assert configured(cache) == ""
    disk_cache.save("one", 1)
    disk_cache.save("other", 2)
    shutil.copy(cache / "kept" / "one", cache / "kept" / "other")
    assert disk_cache.load("one") == 1
    assert disk_cache.load("other") is None
    disk_cache.save("other", 2)
    assert disk_cache.load("other") == 2


@pytest.mark.slow
def test_programs_of_another_gravity_under_the_names_of_this_one_are_made_anew(tmp_path):
    """The ball was at rest, and the run had succeeded."""
    falls, floats = tmp_path / "falls", tmp_path / "floats"
    right, _ = fall(falls, -9.81)
    assert right == "Status.SUCCEEDED -4.905"
    assert fall(floats, 0.0)[0].endswith(" 0.0")
    kept = [sorted((folder / "kept").iterdir(), key=lambda file: file.stat().st_size) for folder in (falls, floats)]
    whole = {file: file.read_bytes() for file in kept[0]}
    assert len(kept[0]) == len(kept[1])
    for file, other in zip(*kept, strict=True):
        shutil.copy(other, file)
    assert fall(falls, -9.81) == (right, "")
    # Written over: keys and contents are as they were. Programs that XLA has compiled may differ in a name.
    again = {file: file.read_bytes() for file in kept[0]}
    assert {len(content) for content in again.values()} == {len(content) for content in whole.values()}
    assert fall(falls, -9.81) == (right, "")
    assert {file: file.read_bytes() for file in kept[0]} == again


@pytest.mark.slow
def test_a_run_without_a_cache_is_made(tmp_path):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    found, said = fall(tmp_path / "cache", -9.81)
    assert found == "Status.SUCCEEDED -4.905"
    assert said.count("ConfigurationWarning") == 1
    assert not [file for file in (tmp_path / "cache").rglob("*") if file.is_file()]


def test_the_command_says_in_one_line_that_nothing_is_kept(tmp_path):
    (tmp_path / "cache").mkdir()
    (tmp_path / "cache").chmod(0o777)
    environment = {**os.environ, "SPHEREJAX_CACHE": str(tmp_path / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    words = [sys.executable, "-m", "spherejax", "list"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stderr.startswith("spherejax: warning: nothing is kept in ")
    assert done.stderr.count("\n") == 1
