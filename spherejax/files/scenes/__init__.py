"""Scenes as TOML files: read, and written."""
