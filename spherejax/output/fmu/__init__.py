"""Scenes as FMUs: in C, with their source, and in Python."""

from spherejax.output.fmu.export import export_fmu

__all__ = ["export_fmu"]
