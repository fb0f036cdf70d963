"""What a motion rubs off a ball and its socket, in one cycle and in many."""

from spherejax.studies.wear.study import wear
from spherejax.studies.wear.wear_in import wear_in
from spherejax.studies.wear.wear_in_result import WearBlock, WearIn
from spherejax.studies.wear.wear_result import Wear, WearWarning

__all__ = ["Wear", "WearBlock", "WearIn", "WearWarning", "wear", "wear_in"]
