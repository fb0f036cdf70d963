"""Joints: where two bodies meet, and the models of how they resist."""
