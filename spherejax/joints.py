"""Joints, drivers and models of joints: every place where two bodies meet, and every way that they resist.

The six usual pairs, two drivers and the four models stand in `sj.` too. Here are also distances, points on planes and
curves (`Line`, `Circle`, `ImplicitCurve`), conditions on directions, further drivers, `Rim` and `tilting_journal`, and
the abstract classes of joints and models of your own.
"""

from spherejax.namespaces import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
