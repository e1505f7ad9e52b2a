"""Measurements → motion: RANSAC, Gauss–Newton, covariances, and the estimates that are kept over
frames."""
