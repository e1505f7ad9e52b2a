"""Bags of ROS 1 and ROS 2, written without ROS: recordings, and the odometry of a run."""
