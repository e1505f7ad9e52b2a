"""PROBE-GK: the noise of each feature from a generalized kernel over the prediction space."""
