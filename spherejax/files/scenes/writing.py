"""Scenes as files: read back and compared before anything is stored."""

from os import PathLike
from pathlib import Path

from spherejax.files.fields.objects import same
from spherejax.files.paths.drafts import draft_of
from spherejax.files.scenes.reading import SceneFile, read_scene_file
from spherejax.files.scenes.settings import SimulationSettings
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene, check_scene


def save_scene(
    scene: Scene,
    path: str | PathLike[str],
    *,
    title: str = "",
    studied: str | None = None,
    settings: SimulationSettings | None = None,
    overwrite: bool = False,
) -> Path:
    """Write a mechanism to a scene file (TOML); reading it gives the same scene, to the last bit.

    Args:
        scene: the mechanism.
        path: the file, `.toml`.
        title: what it is.
        studied: name of the joint whose model is varied on the command line.
        settings: how it is simulated, the table [simulation].
        overwrite: replace an existing file.

    Returns:
        The path.

    Raises:
        SceneError: for a scene that cannot be simulated; for one that no file can hold: Python functions, traced
            numbers, classes that are in no file; for a file that exists.
    """
    path = Path(path).expanduser()
    if path.suffix != ".toml":
        raise SceneError(f"{str(path)!r} is no scene file; give it the ending .toml")
    if path.exists() and not overwrite:
        raise SceneError(f"{str(path)!r} exists; choose another name, or ask to overwrite it")
    if studied is not None and studied not in scene.joints:
        raise SceneError(f"studied: there is no joint {studied!r}")
    check_scene(scene)
    file = SceneFile(scene, title, studied, settings or SimulationSettings())
    # Imported when it is needed: reading needs no TOML writer.
    from spherejax.files.scenes.text import scene_text

    _store(scene_text(file, path.parent), path, file)
    return path


def _store(text: str, path: Path, file: SceneFile) -> None:
    """Write beside the target, read back, compare, and only then take its place."""
    try:
        with draft_of(path) as draft:
            draft.write_text(text, encoding="utf-8")
            _check_draft(draft, path, file)
    except OSError as error:
        raise SceneError(f"cannot write {str(path)!r}: {error.strerror or error}") from error


def _check_draft(draft: Path, path: Path, file: SceneFile) -> None:
    try:
        # Its classes are those of the scene, whose code runs already.
        again = read_scene_file(draft, allow_code=True)
    except SceneError as error:
        raise SceneError(f"{str(path)!r} was not written, for it could not be read again: {error}") from error
    if not same(again.scene, file.scene) or again[1:] != file[1:]:
        raise SceneError(f"{str(path)!r}: the file would not give the scene back; nothing was written")
