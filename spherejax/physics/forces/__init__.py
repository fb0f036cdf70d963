"""Force elements."""
