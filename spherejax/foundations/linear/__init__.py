"""Linear systems of a mechanism's structure."""
