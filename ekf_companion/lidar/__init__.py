"""Lidar-inertial odometry: scans to relative poses with their covariance."""
