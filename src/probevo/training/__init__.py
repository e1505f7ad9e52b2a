"""Recordings → noise model, with truth at every step, at some steps, of positions only, of a closed
loop, or without truth."""
