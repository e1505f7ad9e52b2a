"""Measurements → motion: consensus, Gauss–Newton, covariances, and the beliefs that go from frame
to frame."""
