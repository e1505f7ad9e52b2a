"""Networks that measure what features cannot, each estimate with a covariance (extra ``nets``).

The networks of the thesis regress rotations (HydraNet) and pose corrections (DPC-Net). What they
have in common is here:

====================  =========================================================================
module                what it holds
====================  =========================================================================
``quaternions``       exponential, logarithm, product and mean of unit quaternions
``corrections``       SE(3): the loss of a pose correction with its Jacobian
``target_space``      what is regressed, numbers or rotations, and covariances of its errors
``networks``          trunk, heads and covariance head
``methods``           dropout, ensemble, sigma, hydra, hydra-sigma: loss and prediction of each
``learning``          the training: seeded, can be stopped and resumed, stops early
``network_file``      networks and unfinished trainings as safetensors
``covariance_scale``  calibration of predicted covariances on data left out
``extra``             says what to install where JAX is missing
====================  =========================================================================

Nothing is imported here: the other parts of probevo work without JAX, and never import it.
"""
