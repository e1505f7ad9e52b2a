"""Spoiled recordings: bursts of what happens to real images, and a record of it."""
