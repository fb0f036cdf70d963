"""Functions of one variable: laws of springs and dampers, road profiles, prescribed motions."""
