"""Figures. The only place that imports matplotlib, and only when one of its modules is imported.

Every function returns a `matplotlib.figure.Figure`; saving it is the caller's choice.
"""
