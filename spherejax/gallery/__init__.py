"""Ready scenes: functions from parameters to a `Scene`."""

from spherejax.gallery.andrews import andrews
from spherejax.gallery.bricard import bricard
from spherejax.gallery.car_axis import car_axis
from spherejax.gallery.chain import chain
from spherejax.gallery.five_bar import five_bar
from spherejax.gallery.four_bar import four_bar
from spherejax.gallery.governor import governor
from spherejax.gallery.hip import hip
from spherejax.gallery.journal_bearing import journal_bearing
from spherejax.gallery.lamp import lamp
from spherejax.gallery.leg import leg
from spherejax.gallery.n_four_bar import n_four_bar
from spherejax.gallery.pendulums import double_pendulum, heavy_top, physical_pendulum, simple_pendulum
from spherejax.gallery.piston import piston
from spherejax.gallery.rattling_gears import rattling_gears
from spherejax.gallery.slider_crank import slider_crank
from spherejax.gallery.suspension import suspension
from spherejax.gallery.wheel_suspensions import double_wishbone, mcpherson

__all__ = [
    "andrews",
    "bricard",
    "car_axis",
    "chain",
    "double_pendulum",
    "double_wishbone",
    "five_bar",
    "four_bar",
    "governor",
    "heavy_top",
    "hip",
    "journal_bearing",
    "lamp",
    "leg",
    "mcpherson",
    "n_four_bar",
    "physical_pendulum",
    "piston",
    "rattling_gears",
    "simple_pendulum",
    "slider_crank",
    "suspension",
]
