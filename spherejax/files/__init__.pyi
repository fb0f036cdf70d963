from .mjcf import load_mjcf
from .reading import SceneFile, load_scene, read_scene_file
from .settings import SimulationSettings
from .urdf import load_urdf
from .writing import save_scene

__all__ = ["SceneFile", "SimulationSettings", "load_mjcf", "load_scene", "load_urdf", "read_scene_file", "save_scene"]
