"""Calibration files of stereo rigs and IMUs, as probevo and other tools write them."""
