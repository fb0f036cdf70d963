"""Compiled programs: told apart, kept in memory and on disk."""
