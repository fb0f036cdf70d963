"""How far the clearances of joints let a point of a mechanism move while its motors stand."""

from spherejax.studies.play.play_result import PosePlay
from spherejax.studies.play.study import pose_play

__all__ = ["PosePlay", "pose_play"]
