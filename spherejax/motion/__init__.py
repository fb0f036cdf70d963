"""Equations of motion, consistent start, integration, results."""
