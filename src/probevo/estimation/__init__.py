"""Measurements → motion: RANSAC, Levenberg–Marquardt, covariances, and the estimates that are kept
over frames.

A step is solved by these, from the outermost to the innermost:

    SelfCalibratingEstimator.estimate  → CalibratedMotion      again for jitter, delay or readout
    VisualEstimator.estimate           → VisualMotion          RANSAC, noise, accepted or rejected
    TwoFrameEstimator.estimate         → TwoFrameEstimate      one solve, and the disparity filter
    solve_reprojection                 → ReprojectionSolution  weights and covariance
    levenberg_marquardt.minimize       → Optimum               any measurements of any variables
"""
