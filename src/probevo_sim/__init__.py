"""Simulated worlds, whose truth is known: landmarks with known noise, and rendered scenes.

The **point world** (``point_world``, its settings in ``point_config``) is PROBE-GK's synthetic
experiment: a stereo camera drives a circle among landmarks, and the result is a tracks file without
images. ``noise_laws`` says how the noise of an observation depends on its place in the images.

A **scene** (``scene``) is a drive through a rendered place. ``scene.presets`` lays out the place,
``scene.drive`` the motion of the rig, and ``scene.renderer`` casts the rays. The camera sensor is
``scene.sensor``, the IMU ``scene.imu``. ``scene.recording`` joins them into a ``Sequence``, and
``scene.writer`` writes that as a folder. The docstring of ``scene`` has the details.

``command`` is ``probevo simulate``, which runs both worlds. The core of probevo never imports this
package. Nothing is imported here either, so that ``--help`` stays fast.
"""
