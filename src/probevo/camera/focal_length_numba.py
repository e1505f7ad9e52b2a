"""Compiled loop: the derivative of residuals by an error of the focal length."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import NEAREST, Intrinsics, move_point
from probevo.compiled import compiled


@compiled
def focal_sensitivity(
    T: FloatArray, camera: Intrinsics, refined: FloatArray, sensitivity: FloatArray
) -> None:
    """Fill in ∂e/∂log f, [N, 4], px, of e = y' − f(T g(y)), the baseline being held.

    With q = C m + ρ t of ``transfer`` and c the third column of C, a longer f moves m and ρ so that
    ∂q/∂log f = c − q, and the prediction by

        ∂u'/∂log f = f_u (x (1 − c_z/q_z) + c_x/q_z),    ∂d'/∂log f = d' (1 − c_z/q_z).

    Args:
        T: T_curr_prev, [4, 4].
        camera: the intrinsics.
        refined: the points in the previous frame, (u, v, d), [N, 3], px.
        sensitivity: filled in; zero behind the camera.
    """
    fu, fv, _, _, fb = camera
    for n in range(len(refined)):
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            sensitivity[n] = 0.0
            continue
        stretch = 1.0 - T[2, 2] / Z
        # The residual is observed minus predicted, and u_r = u_l − d: hence the signs.
        u_move = fu * (X / Z * stretch + T[0, 2] / Z)
        v_move = fv * (Y / Z * stretch + T[1, 2] / Z)
        d_move = fb * rho / Z * stretch
        sensitivity[n, 0] = -u_move
        sensitivity[n, 1] = -v_move
        sensitivity[n, 2] = d_move - u_move
        sensitivity[n, 3] = -v_move
