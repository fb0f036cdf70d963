"""An FMU in Python: a scene file and settings, run by this package in the importer's Python; packed by pythonfmu3."""

import json
import shutil
import tempfile
import uuid
from pathlib import Path
from typing import Any

from spherejax.files.paths.drafts import draft_of
from spherejax.files.scenes.reading import load_scene
from spherejax.files.scenes.writing import save_scene
from spherejax.foundations.errors import SceneError
from spherejax.model.scene import Scene
from spherejax.output.fmu.description import DefaultExperiment, Kinds, description
from spherejax.output.fmu.ports import Ports

MODULE = '''\
"""The model of this FMU: the mechanism in scene.toml, run by spherejax."""

from pythonfmu3 import Fmi3SlaveBase
from spherejax.output.fmu.slave import SceneSlave


class {identifier}(SceneSlave, Fmi3SlaveBase):
    """As it is; pythonfmu3 looks for a class that names its base."""

    def to_xml(self, model_options=None):
        """The description that was written at the export."""
        from pathlib import Path
        from xml.etree import ElementTree

        return ElementTree.parse(Path(self.resources) / "description.xml").getroot()
'''


def write_python(
    scene: Scene,
    path: Path,
    identifier: str,
    words: str,
    ports: Ports,
    experiment: DefaultExperiment,
    asked: dict[str, Any],
) -> None:
    """Write the FMU.

    Raises:
        SceneError: without pythonfmu3, and for a scene that no file can hold, such as one with functions of Python.
    """
    library = _library()
    token = str(uuid.uuid4())
    with tempfile.TemporaryDirectory(prefix="spherejax_fmu_") as name:
        folder = Path(name)
        try:
            save_scene(scene, folder / "scene.toml", title=words)
            load_scene(folder / "scene.toml")  # refuses what would need code
        except SceneError as error:
            raise SceneError(
                f"export_fmu: an FMU in Python holds the scene as a scene file, and no code: {error}. Describe it by "
                'what the package has, or export with kind="c"'
            ) from None
        settings = {**asked, "identifier": identifier, "rtol": experiment.rtol}
        (folder / "settings.json").write_text(json.dumps(settings), encoding="utf-8")
        xml = description(identifier, token, words, Kinds(False, True, True), experiment, ports)
        (folder / "description.xml").write_bytes(xml)
        # Python keeps modules by name: two FMUs in one process must not be the same one.
        module = folder / f"model_{token.replace('-', '')}.py"
        module.write_text(MODULE.format(identifier=identifier), encoding="utf-8")
        resources = [folder / each for each in ("scene.toml", "settings.json", "description.xml")]
        made = library.FmuBuilder.build_FMU(module, dest=folder / "made", project_files=resources)
        with draft_of(path) as draft:
            shutil.move(made, draft)


def _library() -> Any:
    try:
        import pythonfmu3
    except ImportError as error:
        raise SceneError(
            "export_fmu: an FMU in Python is packed by pythonfmu3; pip install 'spherejax[fmu]', or export with "
            f'kind="c" ({error})'
        ) from None
    return pythonfmu3
