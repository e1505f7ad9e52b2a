"""Rotations, poses, and uncertainty on them.

``probevo.geometry.conventions`` states the conventions.
"""
