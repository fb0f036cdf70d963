"""Functions of small arrays as straight-line programs of scalars."""
