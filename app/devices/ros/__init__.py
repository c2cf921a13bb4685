"""Devices over ROS 2: topics of CRTK below a namespace, with rclpy where it can be imported."""
