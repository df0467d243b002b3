"""Lidar- and radar-inertial odometry: scans to relative poses with their covariance."""
