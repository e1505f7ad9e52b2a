"""The sliding window: its value, its adjustment, what leaves it, and the IMU within it.

``window`` is the value, ``estimator`` what is done with it. ``equations`` lists what the compiled
normal equations are made of, and ``normal_equations_numba`` is the entry to them.
"""
