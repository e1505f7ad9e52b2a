"""PROBE from drives: random subsets of their features, and the errors of the motions they give."""
