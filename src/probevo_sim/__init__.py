"""Simulated worlds: points with known noise, and rendered scenes. Nothing is imported here, so that
help stays fast."""
