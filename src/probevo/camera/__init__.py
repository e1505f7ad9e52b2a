"""The stereo camera: projection and its inverse, transfer by a motion, rectification."""
