"""Arguments of constructors in a file: what each holds, how it is read, where it stands, how it is written."""
