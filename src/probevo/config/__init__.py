"""Every setting, with its bounds and its reason; those of the odometry by name.

Those of a training are in ``training``, those of networks in ``networks``. How a recording is
opened is in ``probevo.sequences.read_settings``, and all of a run in ``probevo.run_config``.
"""

from probevo.config.odometry import GyroConfig as GyroConfig
from probevo.config.odometry import MotionModelConfig as MotionModelConfig
from probevo.config.odometry import NorthConfig as NorthConfig
from probevo.config.odometry import OdometryConfig as OdometryConfig
from probevo.config.odometry import RansacConfig as RansacConfig
from probevo.config.odometry import SolverConfig as SolverConfig
from probevo.config.odometry import TrackingConfig as TrackingConfig
from probevo.config.odometry import WindowConfig as WindowConfig
