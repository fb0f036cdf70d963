"""Derivatives of whole runs, forward and in reverse."""
