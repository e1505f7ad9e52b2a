"""Downloading of public recordings: what there is, transfer with resumption, and unpacking."""
