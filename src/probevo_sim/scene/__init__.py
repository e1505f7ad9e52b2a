"""A drive through a rendered place: stereo images, IMU, true poses and the truth of each pixel.

**The scene.** ``config`` holds all settings. A preset (``presets``) makes a ``world.World`` of
textured boxes and ellipsoids (``solids``) on a plane beside a road (``route``); objects that move
are ``world.Movers``. ``textures`` holds the mip levels of all textures, which ``texture_patterns``
draws. ``pace`` and ``drive`` plan the motion of the rig: splines whose derivatives are exact.

**The sensors.** ``renderer`` renders the radiance of both cameras at an instant. For this it turns
the world into arrays (``scene_arrays``), lists the solids that each patch of the image may show and
the occluders of the sun (``candidates``), and casts rays (``ray_caster_numba``): what a ray hits is
found in ``intersection_numba``; its radiance in ``shading_numba`` with ``texture_filter_numba``
and, on the ground, ``stochastic_tiling_numba``; the light and shadow of the sun in
``sunlight_numba``. ``sensor`` turns radiance into grey values by exposure and noise. ``imu``
samples the motion.

**The recording.** ``recording`` joins place, drive and sensors into a ``Sequence`` that is rendered
while it is iterated over. ``writer`` writes it as a folder that ``open_sequence`` reads.
"""
