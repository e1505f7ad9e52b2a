"""Rotations, poses, and uncertainty on them. The conventions stand in
``probevo.geometry.conventions``."""
