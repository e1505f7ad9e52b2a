"""Whatever constrains the state: each measurement has a residual, Jacobians, a covariance and a
loss."""
