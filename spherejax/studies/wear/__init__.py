"""What a motion rubs off a ball and its socket, in one cycle and in many."""

from spherejax.studies.wear.result import Wear, WearWarning
from spherejax.studies.wear.study import wear

__all__ = ["Wear", "WearWarning", "wear"]
