"""Programs written out as text for another compiler, or evaluated at once with NumPy."""
