"""PROBE: a weight for each feature from its nearest neighbours in the prediction space."""
