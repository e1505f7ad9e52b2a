"""Recordings → noise model, with truth at every step, at some steps, of positions only, or of a
closed loop alone."""
