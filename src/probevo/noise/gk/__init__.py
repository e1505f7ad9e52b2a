"""PROBE-GK: a covariance for each feature from a generalized kernel over the prediction space."""
