"""The conventions of probevo. Every module follows them; this one holds no code.

Frames
    ``T_b_a`` maps coordinates in frame a to frame b: p_b = T_b_a p_a, so T_c_a = T_c_b T_b_a.
    ``C_b_a`` is its rotation, and its translation is the origin of a seen from b. A camera frame
    has x right, y down, z forward; the frame called ``world`` is the first left camera's.

Tangent vectors
    ξ = [ρ; φ], translation first, in m and rad (thesis eq. 2.13). Exp and Log go between ξ and the
    group.

Perturbations and covariances
    Perturbations act on the left: T = Exp(δξ) T̄ (thesis eqs. 2.22, 2.26), so that δξ lives in the
    *target* frame b of T_b_a. Every pose covariance is the 6×6 covariance of that δξ. ROS uses the
    covariance of translation and fixed-axis angles instead, and GTSAM the covariance of a right
    perturbation with the rotation first; the writers of such formats convert.

Quaternions
    [w, x, y, z], scalar first (thesis eq. 2.7).

Observations and residuals
    A stereo observation is y = (u_l, v_l, u_r, v_r), px, in the rectified left and right images.
    The residual of a track is e = y' − f(T_curr_prev g(y)), observed minus predicted, px.

Arrays and units
    Leading dimensions are batches: rotations [..., 3, 3], poses [..., 4, 4], float64. Names carry
    their units: ``_px``, ``_m``, ``_rad``, ``_s``, ``_ns``. Points are in m, angles in rad; time is
    int64 ns wherever it crosses a boundary.
"""
