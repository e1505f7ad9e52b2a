"""PROBE: a scalar weight for each feature, from its nearest neighbours in the prediction space."""
