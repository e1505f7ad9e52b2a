"""Readers of recordings: a file for each format, with helpers beside it; listed in ``registry``."""
