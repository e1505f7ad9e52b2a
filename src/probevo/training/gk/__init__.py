"""PROBE-GK learned from drives: motions given the noise, and the noise given the motions, in turns."""
