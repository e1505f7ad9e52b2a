"""Recordings → noise model, with full or sparse truth, positions only, a closed loop, or no
truth."""
