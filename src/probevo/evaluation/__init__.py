"""Trajectory errors and the consistency of covariances; nothing here reads or writes files."""
