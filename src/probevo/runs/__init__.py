"""Runs: a recording through the odometry into a folder of results, and results shown again."""
