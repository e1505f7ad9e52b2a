"""Experiments of the papers, repeated in simulation. Nothing is imported here, so that help stays
fast."""
