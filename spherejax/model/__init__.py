"""Scenes as users describe them, and the systems compiled from them."""
