"""A scene file is data: code that it names runs only where it is allowed, and only from the file's own folder."""

import sys
from pathlib import Path

import my_laws
import pytest
from double_pendulum import TEXT, write

import spherejax as sj
from spherejax import cli
from spherejax.studies.sweep.chunks import _unpacked, packed

MAGNET = '\n[forces.push]\nkind = "{}"\nbody = "upper"\nstiffness = 1.0\n'
LAWS = Path(my_laws.__file__).read_text()


def scene_with(folder: Path, kind: str, code: str = LAWS, name: str = "my_laws.py") -> Path:
    """A scene file with a force of a user's, and the file that the force is in."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(code)
    return write(folder, TEXT + MAGNET.format(kind))


def marking(folder: Path) -> str:
    """Code that leaves a file when it runs."""
    return f"open({str(folder / 'it_ran')!r}, 'w').close()\n{LAWS}"


def with_method(head: str, body: str) -> str:
    """The laws, with another method in the magnet."""
    before = "    def wrenches(self"
    return LAWS.replace(before, f"    def {head}:\n        {body}\n\n{before}", 1)


def test_reading_a_file_runs_no_code_unless_it_is_allowed(tmp_path):
    path = scene_with(tmp_path, "my_laws.py:Magnet", marking(tmp_path))
    with pytest.raises(sj.SceneError) as error:
        sj.load_scene(path)
    for word in ("scene.toml:44: forces.push.kind: 'my_laws.py:Magnet'", "allow_code=True", "--allow-code"):
        assert word in str(error.value)
    with pytest.raises(sj.SceneError, match="would run Python code"):
        sj.files.read_scene_file(path)
    assert not (tmp_path / "it_ran").exists()
    assert type(sj.load_scene(path, allow_code=True).forces["push"]).__name__ == "Magnet"
    assert (tmp_path / "it_ran").exists()


@pytest.mark.parametrize(
    "command", ["run", "draw", "effects", "accuracy", "sweep", "fit", "sensitivity", "modes", "cycle", "write"]
)
def test_every_command_asks_before_it_runs_code(command, tmp_path, capsys):
    path = scene_with(tmp_path, "my_laws.py:Magnet", marking(tmp_path))
    needed = {
        "draw": ["--out", "a.png"], "accuracy": ["--out", "a"], "write": ["--out", "a.toml"],
        "sweep": ["--vary", "upper.mass=1:2:2", "--out", "s.zarr"],
        "sensitivity": ["--by", "upper.mass", "--of", "position.upper"],
        "fit": ["--measured", "x.csv", "--start", "bodies.upper.mass"], "cycle": ["--near", "1"],
    }  # fmt: skip
    words = [*needed.get(command, [])]
    assert cli.main([command, str(path), *words]) == 2
    assert "allow it" in capsys.readouterr().err
    assert not (tmp_path / "it_ran").exists()
    assert cli.main([command, "--help"]) == 0
    assert "--allow-code" in capsys.readouterr().out


def test_allowed_code_runs_on_the_command_line(tmp_path, capsys):
    path = scene_with(tmp_path, "sub/my_laws.py:Magnet", name="sub/my_laws.py")
    out = tmp_path / "again.toml"
    assert cli.main(["write", str(path), "--allow-code", "--out", str(out)]) == 0
    assert 'kind = "sub/my_laws.py:Magnet"' in out.read_text()
    assert cli.main(["write", str(path), "--allow-code", "--out", str(tmp_path / "sub" / "a" / "b.toml")]) == 2
    assert cli.main(["write", str(path), "--allow-code", "--out", str(tmp_path / "sub" / "c.toml")]) == 0
    (tmp_path / "apart").mkdir()
    capsys.readouterr()
    assert cli.main(["write", str(path), "--allow-code", "--out", str(tmp_path / "apart" / "c.toml")]) == 2
    assert "force 'push' cannot be written" in (err := capsys.readouterr().err)
    assert "takes code from its own folder only; copy it there" in err


@pytest.mark.parametrize(
    "where",
    ["{outside}/my_laws.py", "../outside/my_laws.py", "./../outside/my_laws.py", "sub/../../outside/my_laws.py"],
)
def test_code_outside_of_the_folder_is_refused_though_code_is_allowed(where, tmp_path):
    outside = tmp_path / "outside"
    scene_with(outside, "my_laws.py:Magnet", marking(tmp_path))
    path = scene_with(tmp_path / "own", where.format(outside=outside) + ":Magnet", name="sub/other.py")
    with pytest.raises(sj.SceneError, match=r"scene.toml:44: forces.push.kind: .*own folder only; move the file there"):
        sj.load_scene(path, allow_code=True)
    assert not (tmp_path / "it_ran").exists()


@pytest.mark.parametrize("what", ["file", "folder"])
def test_a_link_out_of_the_folder_is_refused(what, tmp_path):
    outside = tmp_path / "outside"
    scene_with(outside, "my_laws.py:Magnet", marking(tmp_path))
    path = scene_with(tmp_path / "own", "linked/my_laws.py:Magnet", name="other.py")
    link = tmp_path / "own" / "linked"
    if what == "folder":
        link.symlink_to(outside)
    else:
        link.mkdir()
        (link / "my_laws.py").symlink_to(outside / "my_laws.py")
    with pytest.raises(sj.SceneError, match="a link that leads out of the scene file's folder"):
        sj.load_scene(path, allow_code=True)
    assert not (tmp_path / "it_ran").exists()


def test_the_folder_itself_may_be_a_link(tmp_path):
    scene_with(tmp_path / "own", "my_laws.py:Magnet")
    (tmp_path / "short").symlink_to(tmp_path / "own")
    assert "push" in sj.load_scene(tmp_path / "short" / "scene.toml", allow_code=True).forces


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("no_such_module:Magnet", "no module 'no_such_module' is imported, and a scene file imports none"),
        ("antigravity:Magnet", "Python's own modules"),
        ("os:popen", "Python's own modules"),
        ("C:\\\\\\\\laws\\\\\\\\my_laws.py:Magnet", "own folder only"),
        ("..\\\\\\\\my_laws.py:Magnet", "own folder only"),
        ("\\\\u0000.py:Magnet", "is no path of a file"),
        ("x" * 5000 + ".py:Magnet", "is no"),
        (":Magnet", "a scene file imports none"),
    ],
)
def test_what_is_no_file_beside_the_scene_file_is_refused(kind, message, tmp_path):
    kind = kind.replace("\\\\", "\\")
    before = set(sys.modules)
    with pytest.raises(sj.SceneError) as error:
        sj.load_scene(scene_with(tmp_path, kind), allow_code=True)
    assert message in str(error.value).replace("there is no", "is no")
    assert not {"antigravity", "no_such_module"} & (set(sys.modules) - before)


def test_a_class_of_a_module_that_is_imported_is_taken(tmp_path):
    path = scene_with(tmp_path, "my_laws:Magnet")
    assert type(sj.load_scene(path, allow_code=True).forces["push"]) is my_laws.Magnet
    with pytest.raises(sj.SceneError, match="would run Python code"):
        sj.load_scene(path)


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("x = 1\nraise SystemExit(3)\n", "my_laws.py:2: SystemExit: 3"),
        ("import sys\n\nsys.exit()\n", "my_laws.py:3: SystemExit"),
        ("def f():\n    return 1 / 0\n\nf()\n", "my_laws.py:2: ZeroDivisionError: division by zero"),
        ("x = (\n", "my_laws.py:1: SyntaxError: '(' was never closed"),
        ("import no_such_module\n", "my_laws.py:1: ModuleNotFoundError: No module named 'no_such_module'"),
        ("class Own(BaseException):\n    pass\n\nraise Own('here')\n", "my_laws.py:4: Own: here"),
        (with_method("__init__(self, body: str, stiffness: float)", "raise SystemExit"), "Magnet cannot be made"),
        (with_method("requirements(self)", "return 1 / 0"), "forces.push: Magnet cannot be made"),
    ],
)
def test_what_the_code_raises_is_reported_with_file_and_line(code, message, tmp_path):
    path = scene_with(tmp_path, "my_laws.py:Magnet", code)
    with pytest.raises(sj.SceneError, match=r"scene.toml:4[34]: forces.push") as error:
        sj.load_scene(path, allow_code=True)
    assert message in str(error.value)
    assert "my_laws.py:" in str(error.value).partition("cannot be")[2]


@pytest.mark.parametrize(("wrong", "said"), [("raise SystemExit(0)", "SystemExit: 0"), ("1 / 0", "ZeroDivisionError")])
def test_what_the_code_raises_while_it_is_simulated_is_reported_too(wrong, said, tmp_path, capsys):
    code = LAWS.replace("        lift = self.stiffness", f"        {wrong}\n        lift = self.stiffness", 1)
    path = scene_with(tmp_path, "my_laws.py:Magnet", code)
    assert cli.main(["run", str(path), "--allow-code"]) == 2
    err = capsys.readouterr().err
    line = 1 + code[: code.index(wrong)].count("\n")
    assert f"my_laws.py:{line}: {said}" in err
    assert "Traceback" not in err


def test_code_that_leaves_while_it_is_simulated_ends_the_run_and_not_the_process(tmp_path):
    code = LAWS.replace(
        "        lift = self.stiffness", "        raise SystemExit(0)\n        lift = self.stiffness", 1
    )
    scene = sj.load_scene(scene_with(tmp_path, "my_laws.py:Magnet", code), allow_code=True)
    line = 1 + code[: code.index("raise SystemExit")].count("\n")
    for _ in range(2):
        with pytest.raises(RuntimeError, match=rf"my_laws.py:{line}: SystemExit: 0"):
            sj.simulate(scene, [0.0, 0.1])


def test_a_file_that_was_edited_is_another_class(tmp_path):
    path = scene_with(tmp_path, "my_laws.py:Magnet")
    first, again = (type(sj.load_scene(path, allow_code=True).forces["push"]) for _ in range(2))
    assert first is again
    (tmp_path / "my_laws.py").write_text(LAWS.replace("lift if self.is_on", "2.0 * lift if self.is_on"))
    assert type(sj.load_scene(path, allow_code=True).forces["push"]) is not first


def test_nothing_is_left_beside_the_scene_file_and_compiled_files_do_not_count(tmp_path):
    path = scene_with(tmp_path, "my_laws.py:Magnet")
    sj.load_scene(path, allow_code=True)
    assert {found.name for found in tmp_path.iterdir()} == {"my_laws.py", "scene.toml"}


def test_objects_of_such_classes_reach_another_process(tmp_path, monkeypatch):
    """As a sweep sends them: with the names of the files that were allowed, which run there as well."""
    force = sj.load_scene(scene_with(tmp_path, "my_laws.py:Magnet"), allow_code=True).forces["push"]
    sent = packed(force)
    monkeypatch.delitem(sys.modules, type(force).__module__)  # as in a process that has not read the scene
    there = _unpacked(sent)
    assert (there.stiffness, type(there).__name__, type(there) is type(force)) == (1.0, "Magnet", False)
    monkeypatch.delitem(sys.modules, type(force).__module__)
    (tmp_path / "my_laws.py").write_text("x = 1\n")
    _unpacked.cache_clear()
    with pytest.raises(sj.SceneError, match="is not here as it was where the work was sent from"):
        _unpacked(sent)
