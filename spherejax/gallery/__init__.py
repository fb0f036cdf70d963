"""Ready scenes: functions from parameters to a `Scene`."""

from spherejax.gallery.chain import chain
from spherejax.gallery.four_bar import four_bar
from spherejax.gallery.n_four_bar import n_four_bar

__all__ = ["chain", "four_bar", "n_four_bar"]
