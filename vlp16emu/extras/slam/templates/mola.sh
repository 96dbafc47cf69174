# mola (MOLAorg/mola_lidar_odometry): $rig.
# Read in mola-cli-launchs/lidar_odometry_from_rosbag2.yaml, pipelines/lidar3d-default.yaml, apps/mola-lidar-odometry-cli.cpp.
export MOLA_LIDAR_TOPIC=$points  # topic of the bag; its own value is /ouster/points
export MOLA_LIDAR_NAME=lidar
export MOLA_GNSS_TOPIC=/fix  # topic of the bag; its own value is /gps
export MOLA_IMU_TOPIC=/imu/data  # topic of the bag; its own value is /imu
export MOLA_TF_BASE_LINK=base_link
export MOLA_USE_FIXED_LIDAR_POSE=false
export MOLA_IGNORE_NO_POINT_STAMPS=false  # a cloud without times is an error, instead of no deskewing; its own value is true
