"""Robot descriptions (URDF, MJCF) as scenes."""
