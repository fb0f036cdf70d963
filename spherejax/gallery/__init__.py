"""Ready scenes: functions from parameters to a `Scene`."""

from spherejax.gallery.four_bar import four_bar

__all__ = ["four_bar"]
