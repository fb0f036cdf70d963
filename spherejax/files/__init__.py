"""Scene files: mechanisms described in TOML or URDF, read with their units checked, and written back."""

from spherejax.files.reading import SceneFile, load_scene, read_scene_file
from spherejax.files.settings import SimulationSettings
from spherejax.files.urdf import load_urdf
from spherejax.files.writing import save_scene

__all__ = ["SceneFile", "SimulationSettings", "load_scene", "load_urdf", "read_scene_file", "save_scene"]
