"""PROBE-GK from drives: the motions given the noise, then the noise given the motions, iterated."""
