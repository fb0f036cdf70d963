"""The command line, one file for each command. Strings become objects here and nowhere below."""
