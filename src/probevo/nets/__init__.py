"""Networks that measure what features cannot, each estimate with a covariance (extra ``nets``).

The networks of the thesis regress rotations (HydraNet) and pose corrections (DPC-Net). What they
have in common is here:

=========================  ====================================================================
module                     what it holds
=========================  ====================================================================
``quaternions``            exponential, logarithm, product and mean of unit quaternions
``corrections``            SE(3): the loss of a pose correction with its Jacobian
``target_space``           what is regressed, numbers or rotations, and covariances of its errors
``networks``               trunk, heads and covariance head
``methods``                dropout, ensemble, sigma, hydra, hydra-sigma: loss and prediction of each
``learning``               the training: seeded, can be stopped and resumed, stops early
``network_file``           networks and unfinished trainings as safetensors
``flow_field``             what a network sees of two images: flow on a grid of rays
``image_pairs``            pairs of images of a recording, with their true rotations
``random_copies``          copies of what is learned from: turned further, mirrored
``field_network``          a network over such fields, which begins as a linear regression
``domain``                 whether an input is like those of the training
``trained_network``        what all trained networks have in common: evaluation, domain, file
``recorded_training``      recordings → samples → network, kept as it goes, for all kinds
``calibration``            the factor on covariances that recordings left out ask for
``rotation_…``             network of rotations, its training, and the sensor
``estimated_steps``        steps of an odometry with their images and true corrections
``correction_…``           network of corrections, its targets, its training, and the sensor
``sun_…``                  network of the sun, what it regresses, its training, and the sensor
``triangular_covariance``  covariances that a head may give, whatever its outputs are
``covariance_scale``       calibration of predicted covariances on data left out
``extra``                  says what to install where JAX is missing
=========================  ====================================================================

Nothing is imported here: the other parts of probevo work without JAX, and never import it.
"""
