"""ROS 1 nodes: convert a message, call the core, publish. Only they import rospy."""
