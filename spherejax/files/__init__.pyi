from .robots.mjcf import load_mjcf
from .robots.urdf import load_urdf
from .scenes.reading import SceneFile, load_scene, read_scene_file
from .scenes.settings import SimulationSettings
from .scenes.writing import save_scene

__all__ = ["SceneFile", "SimulationSettings", "load_mjcf", "load_scene", "load_urdf", "read_scene_file", "save_scene"]
