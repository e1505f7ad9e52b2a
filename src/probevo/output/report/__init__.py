"""The report of a run: its page, the figures on it, and the pictures of features."""
