"""Between which positions dry friction in the joints holds a mechanism at rest, and against which efforts."""

from spherejax.studies.friction_band.band_result import FrictionBand
from spherejax.studies.friction_band.study import friction_band

__all__ = ["FrictionBand", "friction_band"]
