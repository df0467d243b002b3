"""A simulated lidar: rays cast into a world from a moving vehicle, each at its own time.

worlds   what stands in a room, a street, a forest, a tunnel, on a plain; casting rays
beams    the directions of a lidar's rays as a function of time
motion   smooth motions, and the exact inertial samples of one
record   a recording of it all from one seed
radar    the same of a radar, with the radial speed of each point
write    the files: lidar.npz, imu.npz, truth.npz, calib.json; bags of ROS 1 and ROS 2
livox    the same as the datagrams of a Livox Mid-360

Frames: world x, y, z with z up; body and lidar forward, left, up. It shares no code with a filter.
"""
