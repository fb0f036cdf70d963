"""Measured mechanisms: models of each, fits to records that others published, and predictions of what was held out."""
