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
``flow_field``        what a network sees of two images: flow on a grid of rays
``image_pairs``       pairs of images of a recording, and copies that turn further
``field_network``     a network over such fields, which begins as a linear regression
``domain``            whether an input is like those of the training
``rotation_network``  a trained network of rotations, and its file
``rotation_sensor``   the same as a sensor of the odometry
``rotation_training`` recordings → network → calibration
``covariance_scale``  calibration of predicted covariances on data left out
``extra``             says what to install where JAX is missing
====================  =========================================================================

Nothing is imported here: the other parts of probevo work without JAX, and never import it.
"""
