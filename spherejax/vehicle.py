"""Vehicle suspensions: the rig for one corner of a car, its corners, tyres and roads."""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
