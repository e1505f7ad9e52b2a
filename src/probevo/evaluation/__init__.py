"""Trajectory errors and the consistency of covariances, free of files."""
