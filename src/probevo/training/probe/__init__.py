"""PROBE learned from drives: random subsets of their features, and the errors of their motions."""
