"""What a run answers: its trajectory, tables, steps, impacts, spectra."""
